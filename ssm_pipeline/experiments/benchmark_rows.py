"""The rows of a matching benchmark: each has a folder of its own, so that results accumulate.

    rows/<row>/summary.csv, pairs.csv, pck.csv   the tables of this row
    rows/<row>/settings.json                     settings, preset, changes, seed, versions, digests
    rows/<row>/losses.csv                        the losses of its training, if it was trained here

A row's name is its method and a hash of everything that decides the result. The same call again
replaces the row; another setting, other shapes or other code add one.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.process import versions
from ssm_pipeline.experiments.matching_benchmark_settings import MatchingBenchmarkSettings
from ssm_pipeline.methods import folder_name

if TYPE_CHECKING:
    from ssm_pipeline.evaluation.matching_benchmark import MatchingBenchmark

ROWS = "rows"
TABLES = ("summary", "pairs", "pck")


@dataclass(frozen=True, eq=False)
class BenchmarkRow:
    """One method's result, and what it depends on.

    Attributes:
        preset: The preset that the settings come from.
        changes: How the settings differ from the preset, such as `training.steps=300`.
        matcher: Digest of the matcher's file; empty for a method without a network.
        losses: A row per training step; None if the matcher was given or there is none.
    """

    scored: MatchingBenchmark
    method: str
    settings: MatchingBenchmarkSettings
    preset: str
    changes: str
    matcher: str
    losses: pd.DataFrame | None = None

    @property
    def name(self) -> str:
        """The method and a hash; the list of the other methods of the call does not count."""
        settings = self.settings.model_dump(mode="json", exclude={"methods"})
        pairs = self.scored.pairs[["x", "y"]].to_numpy().tolist()
        return f"{folder_name(self.method)}-{key_of(settings, pairs, self.matcher)[:8]}"


def keep_row(folder: Path, row: BenchmarkRow) -> pd.DataFrame:
    """Write a row into `folder/rows/`.

    Returns:
        Its line of the summary.
    """
    place = folder / ROWS / row.name
    facts = {"preset": row.preset, "changes": row.changes, "seed": row.settings.seed}
    summary = row.scored.summary.assign(**facts, row=row.name)
    storage.write_table(summary, place / "summary.csv")
    storage.write_table(row.scored.pairs.assign(row=row.name), place / "pairs.csv")
    storage.write_table(row.scored.curve.assign(row=row.name), place / "pck.csv")
    if row.losses is not None:
        storage.write_table(row.losses, place / "losses.csv")
    about = facts | {
        "method": row.method,
        "finished_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "matcher_digest": row.matcher,
        "versions": versions(),
        "settings": row.settings.model_dump(mode="json", exclude={"methods"}),
    }
    storage.write_json(place / "settings.json", about)
    return summary


def all_rows(folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of all rows in a benchmark's folder, oldest row first."""
    places = [path.parent for path in (folder / ROWS).glob("*/settings.json")]
    places.sort(key=lambda place: storage.read_json(place / "settings.json")["finished_at"])
    return {
        name: pd.concat([_read(place / f"{name}.csv") for place in places], ignore_index=True)
        for name in TABLES
    }


def _read(path: Path) -> pd.DataFrame:
    table = storage.read_table(path)
    if "changes" in table:
        table["changes"] = table["changes"].fillna("")
    return table

"""The figures of the results page, as files: a folder per part, and `results.json` beside them.

    <folder>/results.json         format, and of each part: study, changes, seed, commit, machine,
                                  packages, minutes, finished_at, tables
    <folder>/<part>/<table>.csv   the run's tables

A figure is named `<part>/<table>/<row>/<column>`. The row is named by its first column of text (the
method), or by two of them joined by `, ` where one alone does not tell the rows apart.
`tools/fill_tables.py` prints figures by these names in README and the documentation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from ssm_pipeline import storage

FORMAT = 1


def read_results(folder: Path) -> dict[str, Any]:
    """The content of results.json; an empty one where there is none yet."""
    path = folder / "results.json"
    return storage.read_json(path) if path.exists() else {"format": FORMAT, "parts": {}}


def write_part(
    folder: Path, name: str, facts: dict[str, Any], tables: dict[str, pd.DataFrame]
) -> None:
    """Put a part's tables and facts in the place of what was there of it; other parts stay."""
    for stale in (folder / name).glob("*.csv"):
        stale.unlink()
    for table_name, table in tables.items():
        storage.write_table(table, folder / name / f"{table_name}.csv")
    content = read_results(folder)
    content["parts"][name] = facts | {"tables": sorted(tables)}
    content["parts"] = dict(sorted(content["parts"].items()))
    storage.write_json(folder / "results.json", content)


def figures_in(folder: Path) -> dict[str, float]:
    """Every figure of the tables that results.json names, by its name."""
    found: dict[str, float] = {}
    for part, facts in read_results(folder)["parts"].items():
        for table_name in facts["tables"]:
            table = storage.read_table(folder / part / f"{table_name}.csv")
            for row, name in zip(table.to_dict("records"), row_names(table), strict=True):
                for column, value in row.items():
                    if isinstance(value, int | float) and not isinstance(value, bool):
                        found[f"{part}/{table_name}/{name}/{column}"] = float(value)
    return found


def row_names(table: pd.DataFrame) -> list[str]:
    """A name for each row: the fewest leading words, and then modes or folds, that tell all apart.

    >>> row_names(pd.DataFrame({"method": ["full", "S3M"], "x_mm": [1.0, 2.0]}))
    ['full', 'S3M']
    >>> row_names(pd.DataFrame({"pose": ["turned"] * 2, "method": ["full", "S3M"], "x": [1, 2]}))
    ['turned, full', 'turned, S3M']
    """
    words = [c for c in table if pd.api.types.is_string_dtype(table[c]) or table[c].dtype == object]
    numbers = [c for c in ("cohort", "epoch", "epochs", "modes", "fold") if c in table]
    if not words + numbers:
        return [str(number + 1) for number in range(len(table))]
    for count in range(1, len(words + numbers) + 1):
        chosen = (words + numbers)[:count]
        names = table[chosen].astype(str).agg(", ".join, axis=1).tolist()
        if len(set(names)) == len(names):
            result: list[str] = names
            return result
    return [f"{name}, {number + 1}" for number, name in enumerate(names)]

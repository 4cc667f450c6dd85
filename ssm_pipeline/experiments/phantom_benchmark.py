"""`workflow benchmark phantoms`: the whole pipeline against the truth, on several cohorts.

Every cohort is run once lying as a scanner sees patients, and once with each case turned by a
random rotation of up to 40 degrees. Two cases are then up to 80 degrees apart: there rigid
alignment can fail, and what the network is worth shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.evaluation.paired import holm, over_cases
from ssm_pipeline.methods import FULL, TRUTH
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import PhantomData

TURNED_DEG = 40.0
POSES = {"as scanned": 0.0, "turned": TURNED_DEG}
_KEYS = ["family", "pose", "method"]


def run_phantom_benchmark(
    settings: StudySettings,
    options: RunOptions,
    terminal: Terminal,
    seeds: Sequence[int] = DEVELOPMENT,
    poses: Sequence[str] = tuple(POSES),
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row per pose and method over all cohorts, and a row per cohort and true mode.

    seeds  of the cohorts, one each; the study's own seed, of the method, stays as it is.

    In the runs folder: phantom-benchmark.csv, a row per cohort and method: family, pose, cohort
    (its seed), affine_percent (of the cohort's variance), method, geodesic_x100 (mean over all
    template → case pairs, √area-normalised), geodesic_mm, worst_case_x100, generalisation_mm and
    specificity_mm (Chamfer, all modes), variance_kept_percent, and, of phantoms with labels,
    labels_disagree_percent and labels_border_mm. phantom-benchmark-mean.csv, the first table
    returned: means over the cohorts, each with its standard deviation between cohorts (`…_sd`), and
    the error's difference to `full`, all cases of all cohorts together, as
    geodesic_difference_mm, its 95 % interval geodesic_low_mm … geodesic_high_mm (paired bootstrap
    over the cases) and geodesic_p (Holm's correction for the methods). phantom-modes.csv, the
    second: as `phantom_truth.recovered_modes`.
    """
    if not isinstance(settings.data, PhantomData):
        raise StudyError("the phantom benchmark needs phantoms: set data.source to phantoms.")
    family = settings.data.family
    rows, errors, modes = [], [], []
    for pose in poses:
        for seed in seeds:
            change = {"max_rotation_deg": POSES[pose], "seed": seed}
            data = settings.data.model_copy(update=change)
            terminal.say(f"phantoms {family}, cohort {seed}, {pose}")
            folder = run_study(
                f"phantoms-{family}-{pose.replace(' ', '-')}-{seed}",
                settings.model_copy(update={"data": data}),
                options,
                terminal,
            )
            tables = load_run(folder).metrics.tables
            where = {"family": family, "pose": pose, "cohort": seed}
            where["affine_percent"] = _affine_percent(folder)
            rows += [where | row for row in _rows(tables)]
            case_ids = f"{seed}/" + tables["truth"]["case_id"]
            errors.append(tables["truth"].assign(family=family, pose=pose, case_id=case_ids))
            if "recovered_modes" in tables:  # not where size is removed, which changes the modes
                modes.append(tables["recovered_modes"].assign(**where))
    methods = pd.DataFrame(rows)
    all_modes = pd.concat(modes, ignore_index=True) if modes else pd.DataFrame()
    draws = settings.evaluation.bootstrap_draws
    differences = _to_full(pd.concat(errors, ignore_index=True), draws)
    means = _over_cohorts(methods).merge(differences, on=_KEYS, how="left", validate="1:1")
    for name, table in (("benchmark", methods), ("benchmark-mean", means), ("modes", all_modes)):
        storage.write_table(table, options.runs / f"phantom-{name}.csv")
    return means, all_modes


def _affine_percent(folder: Path) -> float:
    stated = storage.read_json(folder / "data" / "phantoms" / "phantoms.json")
    return 100 * float(stated["affine_share"])


def _rows(tables: Mapping[str, pd.DataFrame]) -> list[dict[str, object]]:
    errors, rows = tables["truth"], []
    labels = tables["labels_mean"].set_index("method") if "labels_mean" in tables else None
    for row in tables["comparison"].itertuples():
        own = errors[errors["method"] == row.method]
        of_method = {
            "method": row.method,
            "geodesic_x100": own["geodesic_x100"].mean(),
            "geodesic_mm": own["geodesic_mm"].mean(),
            "worst_case_x100": own["geodesic_x100"].max(),
            "generalisation_mm": row.generalisation_chamfer_mm,
            "specificity_mm": row.specificity_chamfer_mm,
            "variance_kept_percent": row.variance_kept_percent,
        }
        if labels is not None:
            of_method["labels_disagree_percent"] = labels.loc[row.method, "disagree_percent"]
            of_method["labels_border_mm"] = labels.loc[row.method, "border_mm"]
        rows.append(of_method)
    return rows


def _over_cohorts(methods: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over the cohorts of every number, and how many there are."""
    numbers = [name for name in methods if name not in (*_KEYS, "cohort")]
    grouped = methods.groupby(_KEYS, sort=False)
    table = grouped.agg(cohorts=("cohort", "size"))
    for name in numbers:
        table[name] = grouped[name].mean()
        table[f"{name}_sd"] = grouped[name].std()
    return table.reset_index()


def _to_full(errors: pd.DataFrame, draws: int) -> pd.DataFrame:
    """Of every family, pose and method: by how much its error differs from `full`'s.

    On the cases that both score: a method that has a template of its own scores others.
    """
    tables = []
    for (family, pose), group in errors.groupby(["family", "pose"], sort=False):
        full = group[group["method"] == FULL]
        found = {
            method: over_cases(
                own[own["case_id"].isin(full["case_id"])],
                full,
                "geodesic_mm",
                draws,
                np.random.default_rng(0),
            )
            for method, own in group.groupby("method", sort=False)
            if method not in (FULL, TRUTH)
        }
        table = pd.DataFrame(
            {
                "method": list(found),
                "geodesic_difference_mm": [d.value for d in found.values()],
                "geodesic_low_mm": [d.low for d in found.values()],
                "geodesic_high_mm": [d.high for d in found.values()],
                "geodesic_p": holm([d.p for d in found.values()]),
            }
        )
        tables.append(table.assign(family=family, pose=pose))
    return pd.concat(tables, ignore_index=True)

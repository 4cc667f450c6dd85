"""`workflow benchmark phantoms`: the whole pipeline against the truth, on several cohorts.

Every cohort is run twice: in the pose in which a scanner sees patients, and with each case rotated
at random by up to 40 degrees. Two cases are then up to 80 degrees apart, so that rigid alignment
can fail. This shows what the network contributes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.evaluation.paired import holm, over_cases
from ssm_pipeline.experiments.varied_studies import run_varied
from ssm_pipeline.methods import FULL, TRUTH
from ssm_pipeline.records import StudyError
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
    """Run the study on every cohort in every pose, and gather the results in the runs folder.

    phantom-benchmark.csv has a row per cohort and method: family, pose, cohort (its seed),
    affine_percent (of the variance of the cohort), method, geodesic_x100 (mean over all template →
    case pairs, √area-normalised), geodesic_mm, worst_case_x100, generalisation_mm and
    specificity_mm (Chamfer, all modes), variance_kept_percent and, for phantoms with labels,
    labels_disagree_percent and labels_border_mm.

    Args:
        seeds: One per cohort. The seed of the study, which the method uses, stays the same.

    Returns:
        phantom-benchmark-mean.csv: a row per pose and method with the means over the cohorts and
        their standard deviations (`…_sd`). The difference of the error to that of `full` is over
        all cases of all cohorts: geodesic_difference_mm, its 95 % interval geodesic_low_mm …
        geodesic_high_mm (paired bootstrap over the cases) and geodesic_p (with Holm's correction
        for the number of methods). And phantom-modes.csv: the tables of
        `phantom_truth.recovered_modes`, a row per cohort and true mode.

    Raises:
        StudyError: The study is not one of phantoms.
    """
    if not isinstance(settings.data, PhantomData):
        raise StudyError("the phantom benchmark needs phantoms: set data.source to phantoms.")
    family = settings.data.family
    rows, errors, modes = [], [], []
    for pose in poses:
        for seed in seeds:
            change = {"max_rotation_deg": POSES[pose], "seed": seed}
            data = settings.data.model_copy(update=change)
            run = run_varied(
                f"phantoms-{family}-{pose.replace(' ', '-')}-{seed}",
                f"phantoms {family}, cohort {seed}, {pose}",
                settings,
                {"data": data},
                options,
                terminal,
            )
            tables = run.metrics.tables
            where = {"family": family, "pose": pose, "cohort": seed}
            where["affine_percent"] = _affine_percent(run.folder)
            rows += [where | row for row in _rows(tables)]
            case_ids = f"{seed}/" + tables["truth"]["case_id"]
            errors.append(tables["truth"].assign(family=family, pose=pose, case_id=case_ids))
            if "recovered_modes" in tables:  # absent where size is removed, which changes the modes
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
    """The mean and standard deviation of every number over the cohorts, and their count."""
    numbers = [name for name in methods if name not in (*_KEYS, "cohort")]
    grouped = methods.groupby(_KEYS, sort=False)
    table = grouped.agg(cohorts=("cohort", "size"))
    for name in numbers:
        table[name] = grouped[name].mean()
        table[f"{name}_sd"] = grouped[name].std()
    return table.reset_index()


def _to_full(errors: pd.DataFrame, draws: int) -> pd.DataFrame:
    """How much the error of each method differs from that of `full`, per family and pose.

    Only cases that both score are compared: a method with its own template scores other cases.
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

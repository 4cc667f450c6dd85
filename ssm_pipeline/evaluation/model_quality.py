"""How good a shape model is: compactness and generalisation.

Specificity is in `specificity.py`. Source: Davies 2002; Styner et al. 2003.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort, moved
from ssm_pipeline.evaluation.sampling import FixedPoints
from ssm_pipeline.evaluation.settings import EvaluationSettings, mode_counts
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget, chamfer, surface_distance
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh, StudyError
from ssm_pipeline.shape_model.model import ShapeModel

MOST_FOLDS = 100  # models built where every case is to be held out: each costs as much as the whole


def compactness(model: ShapeModel) -> pd.DataFrame:
    """C(M) = Σ_{m≤M} λ_m / Σ λ: modes, variance_mm2, variance_per_point_mm2, share (0 … 1)."""
    return pd.DataFrame(
        {
            "modes": np.arange(1, model.mode_count + 1),
            "variance_mm2": model.variances,
            "variance_per_point_mm2": model.variances / len(model.mean),
            "share": model.compactness,
        }
    )


def generalisation(
    cohort: AlignedCohort,
    settings: EvaluationSettings,
    generator: np.random.Generator,
    folds: Sequence[np.ndarray] | None = None,
    also: Sequence[int] = (),
) -> pd.DataFrame:
    """G(M): how well a model explains a case it was not built from.

    Alignment, mean and modes are redone without the held-out fold; the held-out shape is turned
    onto that mean, projected on its first M modes (no limit on its scores) and reconstructed; the
    reconstruction is compared with the case's original mesh.

    Args:
        cohort: Of N >= 4 cases.
        folds: The cases held out at a time (`held_out_folds`); by default one.
        also: Numbers of modes asked for beside those of the curve.

    Returns:
        One row per case and number of modes M = 1 … N − 2 (leave-one-out; with folds, as many as
        the smallest model has, for all): case_id, modes, chamfer_mm, surface_mm, hd95_mm,
        correspondence_mm, chamfer_floor_mm (Chamfer of two samplings of the case's own mesh: what a
        perfect model would score), points.
    """
    case_ids, mean = cohort.shapes.case_ids, cohort.shapes.vertices.mean(axis=0)
    if folds is None:
        folds = held_out_folds(len(case_ids), 0, seed=0)
    points = FixedPoints.of(mean, cohort.shapes.faces, settings.points, generator)
    limit = most_modes(folds)
    table = pd.concat(
        [
            held_out_errors(cohort, held_out, limit, points, settings, generator, also)
            for held_out in folds
        ]
    )
    table = of_common_modes(table, len(case_ids))
    order = {case_id: index for index, case_id in enumerate(case_ids)}
    return table.sort_values(
        by=["case_id", "modes"], key=lambda c: c.map(order) if c.name == "case_id" else c
    ).reset_index(drop=True)


def held_out_folds(
    count: int, folds: int, seed: int, patients: Sequence[str] | None = None
) -> list[np.ndarray]:
    """The held-out cases (indices), fold by fold, each case exactly once; 0 folds: one at a time,
    or, of more than MOST_FOLDS, so many folds.

    A function of these numbers alone, so that every method leaves out the same cases together.

    Args:
        patients: (count,) whom each case is of: cases of one patient, as both sides, are left out
            together, or the model would know the held-out case's twin. None: each its own.

    Raises:
        StudyError: Where fewer than 3 cases would remain for the model.

    >>> held_out_folds(5, 0, seed=0, patients=["a", "b", "b", "c", "c"])
    [array([0]), array([1, 2]), array([3, 4])]
    """
    if count < 4:
        raise StudyError(
            f"generalisation needs at least 4 cases, so that 3 remain when one is left out; "
            f"{count} found. Add cases, or look at the reasons why others were dropped."
        )
    if patients is None:
        groups = [np.array([case]) for case in range(count)]
    else:
        members: dict[str, list[int]] = {}
        for case, patient in enumerate(patients):
            members.setdefault(patient, []).append(case)
        groups = [np.array(cases) for cases in members.values()]
    what = "cases" if len(groups) == count else "patients"
    if folds == 0 and len(groups) > MOST_FOLDS:
        folds = MOST_FOLDS
    if folds == 0:
        parts = groups
    elif 2 <= folds <= len(groups):
        order = np.array_split(np.random.default_rng(seed).permutation(len(groups)), folds)
        parts = [np.sort(np.concatenate([groups[group] for group in part])) for part in order]
    else:
        raise StudyError(
            f"folds is {folds} for {len(groups)} {what}; 0 (one at a time) or 2 … {len(groups)}."
        )
    remaining = count - max(map(len, parts))
    if remaining < 3:
        raise StudyError(
            f"folds is {folds} for {len(groups)} {what}, so that {remaining} remain when a "
            "fold is left out; a shape model needs at least 3. Ask for more folds, or add cases."
        )
    return parts


def most_modes(folds: Sequence[np.ndarray]) -> int:
    """The number of modes that the model without the largest fold has: every case is scored at
    the same numbers, or a mean over the cases would be of different cases at each."""
    return sum(map(len, folds)) - max(map(len, folds)) - 1


def held_out_errors(
    cohort: AlignedCohort,
    held_out: np.ndarray,
    limit: int,
    points: FixedPoints,
    settings: EvaluationSettings,
    generator: np.random.Generator,
    also: Sequence[int] = (),
) -> pd.DataFrame:
    """`generalisation` of one fold: the cases `held_out` (indices), rebuilt by a model of the rest.

    Args:
        limit: The largest number of modes asked (`most_modes`).
        points: Where the Chamfer distance is measured, of a shape in the model's frame.
    """
    model, frames = cohort.without(held_out)
    # The same numbers for all folds: a model without one fold may have a mode less.
    modes = [
        count
        for count in mode_counts(limit, settings.mode_counts, also)
        if count <= model.mode_count
    ]
    rows: list[dict[str, object]] = []
    for case, frame in zip(held_out, frames, strict=True):
        mesh = moved(cohort.meshes[case], frame)
        shape = frame.apply(cohort.shapes.vertices[case])
        rows += _reconstruction_errors(model, shape, mesh, modes, points, generator)
    return pd.DataFrame(rows)


def of_common_modes(table: pd.DataFrame, cases: int) -> pd.DataFrame:
    """The rows of those numbers of modes at which every case is scored.

    Without one fold or another a model may lose its last mode. A mean at that number would be over
    fewer cases than its neighbours.

    Args:
        table: One row per case and number of modes.
        cases: How many cases there are.
    """
    scored = table.groupby("modes")["case_id"].transform("size")
    return table[scored == cases]


def mean_over_cases(table: pd.DataFrame) -> pd.DataFrame:
    """Per number of modes: mean and standard error over the cases of every column in mm.

    table: as `generalisation` returns.

    Returns:
        Modes, x_mm, x_se_mm, …, samples (cases), points.
    """
    grouped = table.groupby("modes")
    result = pd.DataFrame(index=grouped.size().index)
    for column in [name for name in table.columns if name.endswith("_mm")]:
        result[column] = grouped[column].mean()
        result[column.replace("_mm", "_se_mm")] = grouped[column].sem()
    result["samples"] = grouped.size()
    result["points"] = grouped["points"].first()
    return result.reset_index()


def _reconstruction_errors(
    model: ShapeModel,
    shape: np.ndarray,
    mesh: Mesh,
    mode_numbers: Sequence[int],
    points: FixedPoints,
    generator: np.random.Generator,
) -> list[dict[str, object]]:
    """A row per number of modes for one held-out shape."""
    samples = [
        PointTarget.of(sample_points(mesh.vertices, mesh.faces, points.count, generator))
        for _ in range(2)
    ]
    floor = chamfer(*samples)
    surface = SurfaceTarget.of(mesh.vertices, mesh.faces)
    scores = model.coefficients(shape)
    rows: list[dict[str, object]] = []
    for modes in mode_numbers:
        rebuilt = model.reconstruct(scores[:modes])
        distance = surface_distance(SurfaceTarget.of(rebuilt, model.faces), surface)
        rows.append(
            {
                "case_id": mesh.case_id,
                "modes": modes,
                "chamfer_mm": chamfer(PointTarget.of(points.on(rebuilt)), samples[0]),
                "surface_mm": distance.mean,
                "hd95_mm": distance.hd95,
                "correspondence_mm": np.linalg.norm(rebuilt - shape, axis=1).mean(),
                "chamfer_floor_mm": floor,
                "points": points.count,
            }
        )
    return rows

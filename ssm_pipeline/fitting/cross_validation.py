"""How the model fits a case that it was not built from: each of its own cases, left out in turn.

What a new patient's fit is held against. Nothing here knows the patient, so it is done once a
model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import joblib
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from ssm_pipeline.fitting.model_fit import Fit, fit_model, surface_variance
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model

FEWEST_CASES = 6  # so that five remain for each model, and a spread of six can be told


@dataclass(frozen=True, eq=False)
class LeftOutFits:
    """Of N cases, each fitted without being in the model.

    distances_mm (N, V): from the fitted vertices to the case's whole surface; stated_mm2 (N, V):
    `surface_variance` of each fit; score_errors (N, M): in the standard deviations stated.
    """

    distances_mm: np.ndarray
    stated_mm2: np.ndarray
    score_errors: np.ndarray

    def of(self, cases: np.ndarray) -> LeftOutFits:
        """Those of some cases (K,) int."""
        return LeftOutFits(
            self.distances_mm[cases], self.stated_mm2[cases], self.score_errors[cases]
        )


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """The leave-one-out fits of N cases, per case (N,).

    distances_mm, stated_mm2 (N, V), score_errors (N, M): `left_out`. True scores are those by
                     correspondence.

    Attributes:
        residual_mm: Mean distance of the fitted surface from the case's.
        mahalanobis: Of the fitted scores, standard deviations.
        turned_deg: From the cases' mean orientation, upright (3, 3): model → scanner.
        size: Of the case against the mean, 1 unless the model is without size.
    """

    case_ids: tuple[str, ...]
    residual_mm: np.ndarray
    mahalanobis: np.ndarray
    score_errors: np.ndarray
    turned_deg: np.ndarray
    size: np.ndarray
    upright: np.ndarray
    distances_mm: np.ndarray
    stated_mm2: np.ndarray

    @property
    def left_out(self) -> LeftOutFits:
        return LeftOutFits(self.distances_mm, self.stated_mm2, self.score_errors)


def cross_validate(
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    with_scale: bool = False,
    seed: int = 0,
    jobs: int = 1,
    patients: Sequence[str] | None = None,
) -> CrossValidation:
    """Leave each case out, build the model of the others, fit it to that case's own surface.

    Args:
        shapes: As matched, each in its own millimetres.
        meshes: In the same order.
        patients: (N,) whom each case is of: a patient's other cases are left out of the model, too.

    Raises:
        StudyError: For fewer than six cases, and where fewer than five would be left.
    """
    patients = shapes.case_ids if patients is None else patients
    if not can_judge(patients):
        raise StudyError(
            f"a fit is judged by the model's own cases, left out in turn; {FEWEST_CASES} or more "
            f"are needed for that, {FEWEST_CASES - 1} of other patients than the one left out, and "
            f"the model has {len(patients)}, of {len(set(patients))}."
        )
    work = list(
        in_processes(
            (
                joblib.delayed(_left_out)(shapes, index, mesh, with_scale, seed, patients)
                for index, mesh in enumerate(meshes)
            ),
            jobs,
        )
    )
    fits: list[Fit] = [fitted for fitted, _, _ in work]
    _, frames = align(shapes, with_scale)
    turns = Rotation.from_matrix(np.stack([frame.inverse().rotation for frame in frames]))
    upright = turns.mean()
    return CrossValidation(
        case_ids=shapes.case_ids,
        residual_mm=np.array([fitted.residual_mm for fitted in fits]),
        mahalanobis=np.array([fitted.mahalanobis for fitted in fits]),
        score_errors=of_common_modes([errors for _, _, errors in work]),
        turned_deg=np.degrees((upright.inv() * turns).magnitude()),
        size=np.array([fitted.frame.scale for fitted in fits]),
        upright=upright.as_matrix(),
        distances_mm=np.stack([fitted.distances_mm for fitted in fits]),
        stated_mm2=np.stack([stated for _, stated, _ in work]),
    )


def can_judge(patients: Sequence[str]) -> bool:
    """Whether a model of cases of these patients (N,) has enough left whoever is left out.

    >>> can_judge(["a", "b", "c", "d", "e", "f"]), can_judge(["a", "a", "b", "b", "c", "c"])
    (True, False)
    """
    return len(patients) - max(map(list(patients).count, patients)) >= FEWEST_CASES - 1


def of_common_modes(errors: Sequence[np.ndarray]) -> np.ndarray:
    """(N, M) of N arrays (M_n,): the leading modes that all have. Without one case or another a
    model may keep a last mode of next to no variance, or lose it.

    >>> of_common_modes([np.array([1.0, 2.0]), np.array([3.0])])
    array([[1.],
           [3.]])
    """
    fewest = min(map(len, errors))
    return np.stack([array[:fewest] for array in errors])


def score_inflation(errors: np.ndarray) -> float:
    """By how much stated standard deviations of scores are too small, at least 1: such that 95 %
    of the errors, in those standard deviations, lie within 1.96 times it.

    >>> score_inflation(np.linspace(-4, 4, 1001)) > 1.9
    True
    """
    return max(1.0, float(np.quantile(np.abs(errors), 0.95) / norm.isf(0.025)))


def model_without(
    shapes: CorrespondedShapes, left_out: int, with_scale: bool, patients: Sequence[str]
) -> tuple[ShapeModel, Similarity]:
    """The model without one case and all others of its patient (N,), and the frame from it to that
    case's own millimetres."""
    kept = np.flatnonzero(np.array(patients) != patients[left_out])
    model = pca_model(align(shapes.subset(kept), with_scale)[0])
    return model, best_similarity(model.mean, shapes.vertices[left_out], with_scale=with_scale)


def _left_out(
    shapes: CorrespondedShapes,
    index: int,
    mesh: Mesh,
    with_scale: bool,
    seed: int,
    patients: Sequence[str],
) -> tuple[Fit, np.ndarray, np.ndarray]:
    """The fit, its `surface_variance`, and the scores' errors."""
    model, start = model_without(shapes, index, with_scale, patients)
    fitted = fit_model(model, mesh, start, with_scale, seed=seed)
    true = model.coefficients(start.inverse().apply(shapes.vertices[index]))
    return fitted, surface_variance(model, fitted), (fitted.scores - true) / fitted.score_sd

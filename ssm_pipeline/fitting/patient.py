"""One new patient against a model: pose, scores, reconstruction, and whether to believe them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from ssm_pipeline.fitting.completion import fits_of_parts, uncertainty
from ssm_pipeline.fitting.cross_validation import CrossValidation
from ssm_pipeline.fitting.matched_fit import fit_points
from ssm_pipeline.fitting.model_fit import Fit, fit_model
from ssm_pipeline.fitting.pose_search import StartPose, mirrored, start_poses, turned_deg
from ssm_pipeline.fitting.typicality import CLEARLY_BETTER, Typicality, judge
from ssm_pipeline.fitting.yardstick import Yardstick
from ssm_pipeline.geometry.distances import SurfaceDistance, SurfaceTarget, symmetric
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel

TRIAL_POINTS = 400  # of fits that are only compared with each other
INTERVAL = 0.95
LARGEST_SIZE = 5.0  # times the mean: a child and an adult differ by less, cm and mm by more


@dataclass(frozen=True, eq=False)
class FitReport:
    """The fit of a model to one surface, and whether to believe it. All lengths are in mm.

    Attributes:
        case_id: The patient.
        by: "model" where the model found its own place; "matcher" where the network matched it.
        surface: The patient's surface, V_s vertices, in scanner space.
        faces: `(F, 3)` int, the model's.
        vertices: `(V, 3)` the reconstruction, in scanner space.
        observed: `(V,)` bool, the vertices that the surface covers; all unless it is a part.
        distances_mm: `(V,)` from the reconstruction to the surface, meaningful where observed.
        surface_distances_mm: `(V_s,)` from the surface to the reconstruction.
        sd_mm: `(V,)` standard deviation of each vertex along its normal.
        radius_mm: `(V,)` the patient's surface passes within it at 90 % of the vertices.
        frame: Maps the model's frame to scanner space.
        scores: `(M,)` standard deviations.
        low: `(M,)` lower ends of the 95 % intervals of the scores.
        high: `(M,)` upper ends of the 95 % intervals of the scores.
        cohort_scores: `(N, M)` the scores of the model's own cases.
        cohort_ids: The model's own cases.
        typicality: Distances, tail probabilities, thresholds and flags.
        noise_mm: Standard deviation of a point about the fitted surface, along its normal.
        remarks: What else a reader should know.
    """

    case_id: str
    by: str
    surface: Mesh
    faces: np.ndarray
    vertices: np.ndarray
    observed: np.ndarray
    distances_mm: np.ndarray
    surface_distances_mm: np.ndarray
    sd_mm: np.ndarray
    radius_mm: np.ndarray
    frame: Similarity
    scores: np.ndarray
    low: np.ndarray
    high: np.ndarray
    cohort_scores: np.ndarray
    cohort_ids: tuple[str, ...]
    typicality: Typicality
    noise_mm: float
    remarks: tuple[str, ...]

    @property
    def flags(self) -> tuple[str, ...]:
        """What is out of the ordinary, a sentence each; empty for a case like the model's own."""
        return self.typicality.flags

    @property
    def mahalanobis(self) -> float:
        """Distance of the model's own fit from the mean, in standard deviations."""
        return self.typicality.mahalanobis.value

    @property
    def residual_mm(self) -> float:
        """Mean distance of the model's own fit from the surface, on what was seen."""
        return self.typicality.residual.value

    @property
    def mean_mm(self) -> float:
        """Mean of the two directed mean distances, on what was seen."""
        return self._both_ways.mean

    @property
    def hd95_mm(self) -> float:
        """The larger of the two directed 95th percentiles, on what was seen."""
        return self._both_ways.hd95

    @property
    def _both_ways(self) -> SurfaceDistance:
        return symmetric(self.distances_mm[self.observed], self.surface_distances_mm)

    @property
    def observed_share(self) -> float:
        """The share of the vertices that the surface covers."""
        return float(self.observed.mean())


def fit_patient(
    yardstick: Yardstick,
    surface: Mesh,
    matched: np.ndarray | None = None,
    seed: int = 0,
    jobs: int = 1,
) -> FitReport:
    """Fit a surface from several starts, judge it, and say how uncertain each vertex is.

    A surface that fits upside down or mirrored is fitted so, or as it lies, and flagged. Faces that
    look inward are turned outward, which is flagged too.

    Args:
        yardstick: The model, its cases, and their own fits.
        surface: In millimetres; open where it was cut off.
        matched: `(V, 3)` mm on the surface, matched to the template's vertices by the network and
            adaptation. None: the model finds its own place. Whether the patient is of the model's
            kind is judged by the model's own fit in both cases.
        seed: Decides the points that are drawn on both surfaces.
        jobs: The number of processes.

    Returns:
        Pose, scores, reconstruction, their uncertainty, and the flags.

    Raises:
        CaseError: Where no point of the model faces the surface.
    """
    surface, warnings = outward_and_in_mm(surface, yardstick.model)
    model, reference, with_scale = yardstick.model, yardstick.reference, yardstick.with_scale
    own, turned, mirror_ratio = best_fit(model, surface, reference, with_scale, seed)
    typicality = judge(
        own.residual_mm, own.mahalanobis, turned, mirror_ratio, own.frame.scale, reference
    )
    typicality = replace(typicality, flags=(*warnings, *typicality.flags))
    fitted, remarks = own, []
    if matched is not None:
        fitted = fit_points(model, matched, surface, with_scale)
    if own.is_partial:
        remarks.append(
            f"a part of the surface is missing: {100 * own.observed.mean():.0f} % of the vertices "
            "were seen, the rest is completed"
        )
        left_out = fits_of_parts(
            yardstick.shapes,
            yardstick.meshes,
            own.observed,
            with_scale,
            seed,
            jobs,
            yardstick.patients,
        )
    else:
        left_out = reference.left_out
    spread = uncertainty(model, fitted, left_out)
    margin = norm.isf((1 - INTERVAL) / 2) * spread.score_inflation * fitted.score_sd
    reconstruction = SurfaceTarget.of(fitted.vertices, model.faces)
    return FitReport(
        case_id=surface.case_id,
        by="model" if matched is None else "matcher",
        surface=surface,
        faces=model.faces,
        vertices=fitted.vertices,
        observed=fitted.observed,
        distances_mm=fitted.distances_mm,
        surface_distances_mm=reconstruction.distances_to(surface.vertices),
        sd_mm=spread.sd_mm,
        radius_mm=spread.radius_mm,
        frame=fitted.frame,
        scores=fitted.scores,
        low=fitted.scores - margin,
        high=fitted.scores + margin,
        cohort_scores=model.scores,
        cohort_ids=model.case_ids,
        typicality=typicality,
        noise_mm=fitted.noise_mm,
        remarks=tuple(remarks),
    )


def outward_and_in_mm(surface: Mesh, model: ShapeModel) -> tuple[Mesh, tuple[str, ...]]:
    """The surface with its faces outward, and a flag for what was wrong with it.

    Args:
        surface: As given, open or closed.
        model: The model in millimetres.

    Returns:
        The surface, and a sentence for faces that looked inward and for a size that no patient
        has, which other units than millimetres give.
    """
    flags = []
    # Of an open surface too: seen from its middle, most of it looks away.
    if volume(surface.vertices - surface.vertices.mean(axis=0), surface.faces) < 0:
        surface = Mesh(surface.vertices, surface.faces[:, ::-1], surface.case_id)
        flags.append("inside out: its faces looked inward. They were turned outward for the fit.")
    size = float(np.ptp(surface.vertices, axis=0).max() / np.ptp(model.mean, axis=0).max())
    if not 1 / LARGEST_SIZE <= size <= LARGEST_SIZE:
        flags.append(
            f"units: it is {size:.2g} times as large as the model's mean. Is it in millimetres?"
        )
    return surface, tuple(flags)


def best_fit(
    model: ShapeModel, surface: Mesh, reference: CrossValidation, with_scale: bool, seed: int
) -> tuple[Fit, float, float]:
    """The best fit of several starts; by how many degrees it is turned from how the model's cases
    lie; and how much better or worse the mirrored surface is fitted, as a ratio of misfits.
    """
    # Upright comes first: another orientation has to be clearly better to be believed.
    best, *others = _trials(model, surface, reference.upright, with_scale, seed)
    for other in others:
        if misfit(other, reference) < CLEARLY_BETTER * misfit(best, reference):
            best = other
    # The mirror plane is the body's, so that a mirrored upright organ is upright too.
    images = _trials(model, mirrored(surface), reference.upright, with_scale, seed)
    mirror_ratio = min(misfit(image, reference) for image in images) / misfit(best, reference)
    fitted = fit_model(model, surface, best.frame, with_scale, seed=seed)
    from_upright = reference.upright.T @ fitted.frame.rotation
    return fitted, turned_deg(Similarity(1.0, from_upright, np.zeros(3))), mirror_ratio


def misfit(fitted: Fit, reference: CrossValidation) -> float:
    """What is left of a surface and how odd the shape is, both against the model's own cases: about
    1.4 for a case like them."""
    return float(
        np.hypot(
            fitted.residual_mm / np.median(reference.residual_mm),
            fitted.mahalanobis / np.median(reference.mahalanobis),
        )
    )


def _trials(
    model: ShapeModel, surface: Mesh, upright: np.ndarray, with_scale: bool, seed: int
) -> list[Fit]:
    starts: tuple[StartPose, ...] = start_poses(model, surface, upright, seed)
    return [
        fit_model(model, surface, start.frame, with_scale, points=TRIAL_POINTS, seed=seed)
        for start in starts
    ]

"""Is this surface one of the model's kind? A fit beside the model's own cross-validated fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from ssm_pipeline.fitting.cross_validation import CrossValidation

# One in a hundred of the model's own kind is flagged by each of the two distances.
TAIL = 0.01
# A case may be rotated half as far again as any of the model's, and 45 degrees in any case.
TURNED_DEG, TURNED_TIMES = 45.0, 1.5
# Another orientation's or the other hand's fit is believed if it is a fifth better.
CLEARLY_BETTER = 0.8
# Cases of the model beyond so many robust standard deviations set no threshold. One that was not
# held out with its copy, or whose mask is wrong, would change a threshold by a factor of ten.
OUTLYING = 8.0
SMALLEST_LOG, SMALLEST_DEG = 0.05, 3.0  # robust standard deviations count as at least so much


@dataclass(frozen=True)
class Judged:
    """A number of a fit, the share of the model's own kind that has a larger one, and the
    threshold over which it is flagged, in the number's own unit."""

    value: float
    tail: float
    threshold: float

    @property
    def is_flagged(self) -> bool:
        return self.value > self.threshold


@dataclass(frozen=True)
class Typicality:
    """residual: mean distance, mm; mahalanobis: standard deviations; turned_deg from how the
    model's cases lie, with its threshold; mirror_ratio: the misfit of the mirrored surface
    over this one's (`patient.misfit`); flags: what is out of the ordinary, a sentence each.
    """

    residual: Judged
    mahalanobis: Judged
    turned_deg: float
    turned_threshold_deg: float
    mirror_ratio: float
    flags: tuple[str, ...]

    @property
    def is_flagged(self) -> bool:
        return bool(self.flags)


def judge(
    residual_mm: float,
    mahalanobis: float,
    turned_deg: float,
    mirror_ratio: float,
    size: float,
    reference: CrossValidation,
) -> Typicality:
    """Hold a fit against those of the model's own cases, each fitted without itself.

    Args:
        size: Of the patient against the mean, where the model is without size; else 1.
    """
    residual = tail_of(residual_mm, reference.residual_mm)
    distance = tail_of(mahalanobis, reference.mahalanobis)
    usual_turns = without_outliers(reference.turned_deg, SMALLEST_DEG)
    turned_threshold = max(TURNED_DEG, TURNED_TIMES * float(usual_turns.max()))
    flags = []
    if mirror_ratio < CLEARLY_BETTER:
        flags.append(
            f"mirrored: the mirror image fits better, its misfit is {mirror_ratio:.2f} of this "
            f"one's; below {CLEARLY_BETTER} is flagged. The other side of the body, or an image "
            "whose left and right are exchanged?"
        )
    elif turned_deg > turned_threshold:  # how a wrong hand's fit lies says nothing
        flags.append(
            f"turned: it lies {turned_deg:.0f} degrees from how the model's cases lie; "
            f"{turned_threshold:.0f} or less is usual. Upside down?"
        )
    if residual.is_flagged:
        flags.append(
            f"unlike the model: {residual.value:.2f} mm is left between surface and fit; of the "
            f"model's kind, one in {1 / TAIL:.0f} has more than {residual.threshold:.2f} mm. "
            "Another organ, an illness the model has not seen, or a faulty mask?"
        )
    if distance.is_flagged:
        flags.append(
            f"extreme: {distance.value:.1f} standard deviations from the mean; of the model's "
            f"kind, one in {1 / TAIL:.0f} is more than {distance.threshold:.1f} away."
        )
    smallest, largest = usual_sizes(reference)
    if not smallest <= size <= largest:
        flags.append(
            f"size: {size:.2f} times the mean; of the model's kind, one in {1 / TAIL:.0f} lies "
            f"outside {smallest:.2f} to {largest:.2f}."
        )
    return Typicality(residual, distance, turned_deg, turned_threshold, mirror_ratio, tuple(flags))


def usual_sizes(reference: CrossValidation) -> tuple[float, float]:
    """Between which sizes 99 in 100 of the model's kind are; (1, 1) where size is no part of the
    pose."""
    logs = without_outliers(np.log(reference.size), SMALLEST_LOG)
    spread = float(logs.std(ddof=1)) * np.sqrt(1 + 1 / len(logs))
    reach = spread * float(student_t.isf(TAIL / 2, len(logs) - 1))
    return float(np.exp(logs.mean() - reach)), float(np.exp(logs.mean() + reach))


def without_outliers(values: np.ndarray, smallest: float) -> np.ndarray:
    """The values within `OUTLYING` robust standard deviations of their median.

    Args:
        values: (N,).
        smallest: A robust standard deviation below this counts as this.

    >>> without_outliers(np.array([1.0, 1.2, 0.9, 1.1, -9.0]), 0.05).tolist()
    [1.0, 1.2, 0.9, 1.1]
    """
    away = np.abs(values - np.median(values))
    kept: np.ndarray = values[away <= OUTLYING * max(1.4826 * float(np.median(away)), smallest)]
    return kept


def tail_of(value: float, seen: np.ndarray) -> Judged:
    """Where a positive number lies in the distribution of which `seen` (N,) is a sample.

    The distribution is log-normal with estimated parameters, so its predictive distribution is
    Student's t with N − 1 degrees of freedom, wider by √(1 + 1/N). Outliers among `seen` are left
    out. A rank among N could not be below 1 / (N + 1).
    """
    logs = without_outliers(np.log(np.maximum(seen, 1e-12)), SMALLEST_LOG)
    count = len(logs)
    spread = float(logs.std(ddof=1)) * np.sqrt(1 + 1 / count) + 1e-12
    centre = float(logs.mean())
    tail = float(student_t.sf((np.log(max(value, 1e-12)) - centre) / spread, count - 1))
    threshold = float(np.exp(centre + spread * student_t.isf(TAIL, count - 1)))
    return Judged(value, tail, threshold)

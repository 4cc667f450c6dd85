"""Settings of the evaluation stage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from ssm_pipeline.settings import Settings


class EvaluationSettings(Settings):
    """How much is sampled. All methods of one comparison are scored with the same settings."""

    points: int = Field(4000, ge=50)  # surface samples per shape, for the Chamfer distance
    samples: int = Field(1000, ge=2)  # shapes drawn from the model, for specificity (Chamfer)
    surface_samples: int = Field(100, ge=2)  # of these, scored vertex to triangle as well
    surface_points: int = Field(1000, ge=20)  # vertices asked per shape, there
    # Of a draw's and a mesh's samples, asked for their distance to all of the other's: the mean of
    # an even subset is nearly that of all.
    asked_points: int = Field(2000, ge=20)
    screening_points: int = Field(128, ge=20)  # samples that pick the nearest training mesh
    screening_errors: float = Field(2.0, ge=0)  # standard errors a mesh must be worse by to be out
    mode_counts: int = Field(24, ge=1)  # curve points over the modes; all modes where fewer
    # Held-out folds for generalisation. 0: one case at a time; of more than 100, 100 folds.
    folds: int = Field(0, ge=0)
    # Draws of each model built without one case, for the interval of specificity; 0: no interval.
    # It is most of an evaluation's time where asked for: 24 are enough.
    jackknife_samples: int = Field(0, ge=0)
    fit_surfaces: bool = True  # generalisation also by fitting the model to the surface alone
    coverage_edges: float = Field(1.5, gt=0)  # "no template point near", in mean edge lengths
    labels: bool = True  # carry labels of parts from case to case, where the masks have several
    landmarks: Path | None = None  # folder of <case id>.mrk.json or .fcsv, same names; None: none
    bootstrap_draws: int = Field(10_000, ge=100)  # resamplings of the cases, for intervals


def mode_counts(total: int, limit: int, also: Sequence[int] = ()) -> list[int]:
    """The numbers of modes that a curve is computed at: 1 … total, or `limit` of them, even.

    Args:
        also: More of them, such as those that hold 95 % of the variance; none above the total.

    >>> mode_counts(20, 3, also=[7])
    [1, 7, 11, 20]
    """
    if total <= limit:
        return list(range(1, total + 1))
    step = (total - 1) / max(limit - 1, 1)
    even = {1 + round(index * step) for index in range(limit)}
    return sorted(even | {modes for modes in also if modes <= total})

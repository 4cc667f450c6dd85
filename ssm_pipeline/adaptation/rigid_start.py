"""What there is without a network: rigid alignment, and the template nearest to the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.rigid import iterative_closest_point
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh, SpectralBasis
from ssm_pipeline.training.partners import partner_pairs

SAMPLES = 4000  # points on each surface


def rigid_motion(
    template: Mesh | SpectralBasis, case: Mesh | SpectralBasis, seed: int
) -> Similarity:
    """Lays the template on the case, both at unit area and centred: iterative closest points.

    Args:
        seed: Of the samples of both surfaces: every method that starts here starts alike.
    """
    generator = np.random.default_rng(seed)
    return iterative_closest_point(
        sample_points(template.vertices, template.faces, SAMPLES, generator),
        sample_points(case.vertices, case.faces, SAMPLES, generator),
    )


def rigidly_aligned(template: SpectralBasis, case: SpectralBasis, seed: int) -> np.ndarray:
    """(V, 3) the template's vertices after `rigid_motion`."""
    return rigid_motion(template, case, seed).apply(template.vertices)


def rank_templates_by_distance(
    bases: Sequence[SpectralBasis], partners: int, seed: int
) -> pd.DataFrame:
    """case_id, mean_loss: the mean distance of each case, rigidly aligned, from its partners.

    In √area; the smallest is the case most like the others. (`choose_template` is the same by the
    loss of trained networks.)
    """
    losses: list[list[float]] = [[] for _ in bases]
    for x, y in partner_pairs(len(bases), partners):
        aligned = rigidly_aligned(bases[x], bases[y], seed)
        distance = closest_points(aligned, bases[y].vertices, bases[y].faces).distances.mean()
        losses[x].append(float(distance))
        losses[y].append(float(distance))
    means = [float(np.mean(row)) for row in losses]
    return pd.DataFrame({"case_id": [basis.case_id for basis in bases], "mean_loss": means})

"""Adapt a posed template to a case: Δ_s of the paper's section 4.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ssm_pipeline.adaptation.gauss_newton import gauss_newton
from ssm_pipeline.adaptation.objective import AdaptationObjective, MapPull, Triangles
from ssm_pipeline.adaptation.settings import AdaptationSettings


@dataclass(frozen=True, eq=False)
class Adapted:
    """offsets Δ (V, 3), and the objective that they minimise."""

    offsets: np.ndarray
    objective: AdaptationObjective

    def chamfer(self) -> float:
        """The squared distance left between X + Δ and Y, both directed means added."""
        return self.objective.nearest(self.objective.moved_samples(self.offsets)).chamfer


def adapt(
    x: Triangles,
    laplacian: sp.csr_matrix,
    y: Triangles,
    settings: AdaptationSettings,
    seed: int,
    pull: MapPull | None = None,
) -> Adapted:
    """Offsets Δ that bring the surface X onto Y and stay smooth, all at unit area.

    Args:
        laplacian: The template's.
        seed: Of the samples on both surfaces.
        pull: Where a map says the vertices go, if it is to be heard.

    Source: Cao et al. 2024, Eq. 15, with the balance of AdaptationSettings.stiffness and
    Gauss–Newton in place of VectorAdam.
    """
    generator = np.random.default_rng(seed)
    objective = AdaptationObjective(x, laplacian, y, settings, generator, pull)
    offsets, _ = gauss_newton(objective, settings.steps, settings.tangential)
    return Adapted(offsets, objective)

"""The known truth of synthetic cases, and tables of scores."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from ssm_pipeline.geometry.similarity import Similarity


@dataclass(frozen=True, eq=False)
class PhantomTruth:
    """Exact correspondences and modes of a synthetic cohort.

    Attributes:
        vertices: `(N, R, 3)` mm. Vertex r is the same anatomical point in all N cases.
        faces: `(R_f, 3)` int, shared.
        mean: `(R, 3)` mm.
        modes: `(M, R, 3)` displacement fields, one standard deviation each, mm.
        scores: `(N, M)` in standard deviations, as drawn.
        case_ids: The N cases.
        frames: For each case, the rigid motion applied after deformation (identity as scanned).
        labels: `(R,)` int, the anatomical label of each point, where the masks have several.
        seen: `(N, R)` bool, the points within the case's field of view. None: all.
    """

    vertices: np.ndarray
    faces: np.ndarray
    mean: np.ndarray
    modes: np.ndarray
    scores: np.ndarray
    case_ids: tuple[str, ...]
    frames: tuple[Similarity, ...]
    labels: np.ndarray | None = None
    seen: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class KnownPair:
    """Two shapes of a set whose true correspondence is known at some points.

    Attributes:
        x: The number of the first shape in the set.
        y: The number of the second shape in the set.
        on_x: `(Q,)` int, vertices of x.
        on_y: `(Q,)` int. Vertex on_x[q] of x and on_y[q] of y are the same point.
    """

    x: int
    y: int
    on_x: Int[np.ndarray, " Q"]
    on_y: Int[np.ndarray, " Q"]


@dataclass(frozen=True, eq=False)
class SurfaceLabels:
    """The labelled part of the organ that each vertex of a case's mesh belongs to.

    A vertex belongs to the part with the largest share.

    Attributes:
        case_id: The case.
        values: `(L,)` int, the labels, ascending.
        shares: `(V, L)`, how much of the organ around a vertex has each label. Rows sum to 1.
    """

    case_id: str
    values: Int[np.ndarray, " L"]
    shares: Float[np.ndarray, "V L"]

    @property
    def labels(self) -> np.ndarray:
        """`(V,)` int, the label of each vertex."""
        result: np.ndarray = self.values[self.shares.argmax(axis=1)]
        return result


@dataclass(frozen=True, eq=False)
class Metrics:
    """Tables of scores.

    Attributes:
        tables: Tidy tables by name. The names of their columns contain the units.
    """

    tables: dict[str, pd.DataFrame] = field(default_factory=dict)

"""What is known of synthetic cases, and the tables that say how near one came."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ssm_pipeline.geometry.similarity import Similarity


@dataclass(frozen=True, eq=False)
class PhantomTruth:
    """Exact correspondences and modes of a synthetic cohort.

    vertices   (N, R, 3) mm: vertex r is the same anatomical point in all N cases.
    faces      (R_f, 3) int, shared.
    modes      (M, R, 3) displacement fields, one standard deviation each, mm.
    scores     (N, M) in standard deviations, as drawn.
    frames     per case, the rigid motion applied after deformation (identity as scanned).
    labels     (R,) int anatomical label of each point, where the masks carry several.
    seen       (N, R) bool: points that lie within the case's field of view; None: all.
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

    x, y        their numbers in the set.
    on_x, on_y  (Q,) int: vertex on_x[q] of x and on_y[q] of y are the same point.
    """

    x: int
    y: int
    on_x: np.ndarray
    on_y: np.ndarray


@dataclass(frozen=True, eq=False)
class SurfaceLabels:
    """To which labelled part of the organ each vertex of a case's mesh belongs.

    values (L,) int, ascending: the labels; shares (V, L), rows summing to 1: how much of the organ
    around a vertex has each label. A vertex belongs to the part of largest share.
    """

    case_id: str
    values: np.ndarray
    shares: np.ndarray

    @property
    def labels(self) -> np.ndarray:
        """(V,) int."""
        result: np.ndarray = self.values[self.shares.argmax(axis=1)]
        return result


@dataclass(frozen=True, eq=False)
class Metrics:
    """Tidy tables by name, units in the column names."""

    tables: dict[str, pd.DataFrame] = field(default_factory=dict)

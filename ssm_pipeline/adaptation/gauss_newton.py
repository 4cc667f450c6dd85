"""The fast solver: point-to-plane Gauss–Newton on the objective of `objective.py`."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ssm_pipeline.adaptation.objective import AdaptationObjective, Nearest
from ssm_pipeline.geometry.barycentric import interpolated

PAIRS = [(a, b) for a in range(3) for b in range(3)]


def gauss_newton(
    objective: AdaptationObjective, steps: int = 10, tangential: float = 0.005
) -> tuple[np.ndarray, list[float]]:
    """Minimise from Δ = 0.

    Each step finds the nearest samples, replaces their squared distances by the distance to the
    tangent plane there plus `tangential` times the distance along it, and solves the sparse system.
    Sliding is cheap, as it is on a surface. The last steps weigh both alike: with the neighbours
    held that is the objective itself, so those can only lower it.

    Returns:
        The best offsets (V, 3) and the objective before each step and at the end.
    """
    system = _System(objective)
    offsets = np.zeros_like(objective.vertices)
    best, best_value, values = offsets, np.inf, []
    for step in range(steps + 1):
        near = objective.nearest(objective.moved_samples(offsets))
        values.append(objective.value(offsets, near))
        if values[-1] < best_value:
            best, best_value = offsets, values[-1]
        if step < steps:
            exact = step >= steps - 2
            start = best if exact else offsets
            if start is not offsets:
                near = objective.nearest(objective.moved_samples(start))
            offsets = system.solve(near, 1.0 if exact else tangential)
    return best, values


class _System:
    """The normal equations of one pair: their sparsity is found once, filled anew each step."""

    def __init__(self, objective: AdaptationObjective) -> None:
        self.objective = objective
        faces, count = objective.faces, len(objective.vertices)
        # Unknown 3v + d is coordinate d of vertex v. One entry a face, corner pair and (d, e).
        rows = [3 * faces[:, a] + d for a, _ in PAIRS for d, _ in PAIRS]
        columns = [3 * faces[:, b] + e for _, b in PAIRS for _, e in PAIRS]
        row, column = np.concatenate(rows), np.concatenate(columns)
        smooth = sp.kron(objective.laplacian * objective.stiffness, sp.identity(3)).tocoo()
        row, column = np.concatenate([row, smooth.row]), np.concatenate([column, smooth.col])
        position = column.astype(np.int64) * (3 * count) + row
        keys, self.slot = np.unique(position, return_inverse=True)
        self.indices = (keys % (3 * count)).astype(np.int32)
        starts = np.searchsorted(keys // (3 * count), np.arange(3 * count + 1))
        self.indptr = starts.astype(np.int32)
        self.smooth = smooth.data

    def solve(self, near: Nearest, tangential: float) -> np.ndarray:
        """Offsets that minimise the squared residuals for the given neighbours."""
        obj = self.objective
        # Both directions as one list of residuals: sample of X → point of Y with its normal.
        sample = np.concatenate([np.arange(len(obj.face)), near.x_of_y])
        point = np.concatenate([near.y_of_x, np.arange(len(obj.target))])
        normal, face, bary = obj.target_normals[point], obj.face[sample], obj.weights[sample]
        scale = 1 / len(obj.face)
        at_rest = interpolated(obj.vertices, obj.faces[face], bary)
        residual = obj.target[point] - at_rest
        along = np.einsum("sd,sd->s", normal, residual)
        pull = scale * ((1 - tangential) * along[:, None] * normal + tangential * residual)

        # W = (1 − tangential) n nᵀ + tangential I, summed over the samples of each face.
        metric = {
            (d, e): scale
            * ((1 - tangential) * normal[:, d] * normal[:, e] + (tangential if d == e else 0.0))
            for d in range(3)
            for e in range(d, 3)
        }
        face_count = len(obj.faces)
        blocks = {}
        for a in range(3):
            for b in range(a, 3):
                both = bary[:, a] * bary[:, b]
                for (d, e), w in metric.items():
                    blocks[a, b, d, e] = np.bincount(face, both * w, face_count)
        entries = [
            blocks[min(a, b), max(a, b), min(d, e), max(d, e)] for a, b in PAIRS for d, e in PAIRS
        ]
        data = np.bincount(self.slot, np.concatenate([*entries, self.smooth]))
        size = len(self.indptr) - 1
        matrix = sp.csc_matrix((data, self.indices, self.indptr), shape=(size, size))
        if obj.pull is not None:
            matrix = matrix + sp.diags(np.repeat(obj.pull.weights, 3), format="csc")
        # Far from both surfaces' samples a vertex may slide freely: keep the factor regular.
        matrix = matrix + (1e-6 * matrix.diagonal().mean()) * sp.identity(size, format="csc")

        right = np.zeros((size // 3, 3))
        for corner in range(3):
            vertex = obj.faces[face, corner]
            for d in range(3):
                right[:, d] += np.bincount(vertex, bary[:, corner] * pull[:, d], size // 3)
        if obj.pull is not None:
            right += obj.pull.weights[:, None] * (obj.pull.points - obj.vertices)
        factor = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        result: np.ndarray = factor.solve(right.ravel()).reshape(-1, 3)
        return result

"""Surfaces, and what is found on and between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records.errors import CaseError, StudyError


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64 mm LPS, faces (F, 3) int64, outward oriented.

    Read-only. Raises CaseError for arrays of other shapes, numbers that are not finite, and faces
    that name missing vertices.

    >>> mesh = Mesh([[0, 0, 0], [30, 0, 0], [0, 40, 0]], [[0, 1, 2]], "liver_7")
    >>> mesh.vertices.dtype, len(mesh.faces)
    (dtype('float64'), 1)
    """

    vertices: np.ndarray
    faces: np.ndarray
    case_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _read_only(self.vertices, np.float64))
        object.__setattr__(self, "faces", _read_only(self.faces, np.int64))
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise CaseError(self.case_id, f"vertices have shape {self.vertices.shape}, not (V, 3)")
        if self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise CaseError(self.case_id, f"faces have shape {self.faces.shape}, not (F, 3)")
        if not np.isfinite(self.vertices).all():
            raise CaseError(self.case_id, "the mesh has vertices that are not finite")
        if self.faces.size and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise CaseError(self.case_id, "the mesh has faces that name missing vertices")


@dataclass(frozen=True, eq=False)
class SpectralBasis:
    """Laplacian eigenpairs and operators of one mesh, centred and scaled to unit area.

    eigenvalues (K,) ascending; eigenvectors (V, K), mass-orthonormal; mass (V,) lumped, sum 1;
    laplacian (V, V) sparse, positive semidefinite; gradient_x, gradient_y (V, V) sparse: the two
    tangential components of DiffusionNet's per-vertex gradient; frame: unit-area → millimetres.
    """

    case_id: str
    vertices: np.ndarray
    faces: np.ndarray
    eigenvalues: np.ndarray
    eigenvectors: np.ndarray
    mass: np.ndarray
    laplacian: sp.csr_matrix
    gradient_x: sp.csr_matrix
    gradient_y: sp.csr_matrix
    frame: Similarity

    def __post_init__(self) -> None:
        for name in ("eigenvalues", "eigenvectors", "mass", "vertices"):
            finite = np.isfinite(getattr(self, name))
            if not finite.all():
                self._refuse(name, int(np.argwhere(~finite)[0][0]))
        for name in ("laplacian", "gradient_x", "gradient_y"):
            operator = getattr(self, name)
            if not np.isfinite(operator.data).all():
                bad = operator.tocoo().row[~np.isfinite(operator.tocoo().data)]
                self._refuse(name, int(bad[0]))

    def _refuse(self, name: str, row: int) -> None:
        raise CaseError(
            self.case_id,
            f"{name} is not finite at row {row} (of {len(self.vertices)} vertices). Look at the "
            "triangles around that vertex, or remesh the surface.",
        )


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Template vertex → point on a case's surface.

    case_faces (V_t,) int; barycentric (V_t, 3); nearest_vertex (V_t,) int: the case's vertex
    nearest to the adapted template vertex. `fitted` (V_t, 3) mm: the adapted template X(1, 1)
    in the case's own space, before it is carried onto the surface. `start`: where the
    adaptation began: rigid, turned (rigidly, by the map), network, mean or as scanned.

    >>> case = Mesh([[0, 0, 0], [30, 0, 0], [0, 40, 0]], [[0, 1, 2]], "b")
    >>> middle = Correspondence("a", "b", np.array([0]), np.array([[0.5, 0.5, 0.0]]), np.array([0]),
    ...                         np.array([[15.0, 0.0, 1.0]]))
    >>> middle.points_on(case)
    array([[15.,  0.,  0.]])
    """

    template_id: str
    case_id: str
    case_faces: np.ndarray
    barycentric: np.ndarray
    nearest_vertex: np.ndarray
    fitted: np.ndarray
    start: str = "rigid"

    def points_on(self, case: Mesh) -> np.ndarray:
        """(V_t, 3) mm: the matched points on the case's surface."""
        return interpolated(case.vertices, case.faces[self.case_faces], self.barycentric)


@dataclass(frozen=True, eq=False)
class ShapePath:
    """The two-parameter family X(t, t_s) = X(t) + t_s Δ_s(t), on the template's faces.

    times (T,) in [0, 1]; pose (T, V, 3) mm: X(t); offsets (T, V, 3) mm: Δ_s(t).
    """

    template_id: str
    case_id: str
    times: np.ndarray
    pose: np.ndarray
    offsets: np.ndarray
    faces: np.ndarray

    def at(self, t: float, t_s: float = 1.0) -> np.ndarray:
        """(V, 3) mm; linear between the stored times. Raises ValueError outside [0, 1]."""
        if not (0 <= t <= 1 and 0 <= t_s <= 1):
            raise ValueError(f"t = {t} and t_s = {t_s}; both must lie in [0, 1]")
        upper = int(np.clip(np.searchsorted(self.times, t), 1, len(self.times) - 1))
        low, high = self.times[upper - 1], self.times[upper]
        w = (t - low) / (high - low)
        pose = (1 - w) * self.pose[upper - 1] + w * self.pose[upper]
        offset = (1 - w) * self.offsets[upper - 1] + w * self.offsets[upper]
        result: np.ndarray = pose + t_s * offset
        return result


@dataclass(frozen=True, eq=False)
class CorrespondedShapes:
    """N shapes on one template: vertices (N, V, 3) mm, shared faces (F, 3), case ids. Read-only.

    Raises StudyError for two cases with one id, CaseError for a vertex that is not finite.

    >>> triangle = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])
    >>> vertices = np.stack([triangle, 2 * triangle, 3 * triangle])
    >>> shapes = CorrespondedShapes(vertices, np.array([[0, 1, 2]]), ("a", "b", "c"), "b")
    >>> shapes.template[1]
    array([6., 0., 0.])
    >>> shapes.subset([0, 2]).case_ids
    ('a', 'c')
    """

    vertices: np.ndarray
    faces: np.ndarray
    case_ids: tuple[str, ...]
    template_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _read_only(self.vertices, np.float64))
        object.__setattr__(self, "faces", _read_only(self.faces, np.int64))
        shape = self.vertices.shape
        if len(shape) != 3 or shape[2] != 3 or len(self.vertices) != len(self.case_ids):
            raise ValueError(
                f"vertices have shape {self.vertices.shape} for {len(self.case_ids)} cases; "
                "(N, V, 3) is needed"
            )
        refuse_doubled(self.case_ids)
        if not np.isfinite(self.vertices).all():
            case, vertex = np.argwhere(~np.isfinite(self.vertices))[0, :2]
            raise CaseError(self.case_ids[case], f"vertex {vertex} of its shape is not finite.")

    @property
    def template(self) -> np.ndarray:
        """(V, 3) mm: the template's own shape; the first case's where the template is left out."""
        in_cohort = self.template_id in self.case_ids
        result: np.ndarray = self.vertices[
            self.case_ids.index(self.template_id) if in_cohort else 0
        ]
        return result

    def subset(self, indices: Sequence[int] | np.ndarray) -> CorrespondedShapes:
        """The cases at these places, in this order, on the same template."""
        chosen = np.asarray(indices, dtype=np.int64)
        case_ids = tuple(self.case_ids[index] for index in chosen)
        return CorrespondedShapes(self.vertices[chosen], self.faces, case_ids, self.template_id)


def refuse_doubled(case_ids: Sequence[str]) -> None:
    """Raise StudyError where two cases have one id: what is theirs is looked up by it."""
    if len(set(case_ids)) == len(case_ids):
        return
    case_id, times = Counter(case_ids).most_common(1)[0]
    raise StudyError(
        f"{times} cases have the id {case_id}; each needs one of its own. Name them where they are "
        "read: read_mesh(path, case_id=...)."
    )


def _read_only(array: np.ndarray, kind: type) -> np.ndarray:
    """A view that can't be written to; no copy. The caller's own array stays as it is."""
    view: np.ndarray = np.asarray(array, dtype=kind).view()
    view.flags.writeable = False
    return view

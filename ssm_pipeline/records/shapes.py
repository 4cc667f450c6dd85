"""Surfaces, and what is computed on and between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records.errors import CaseError, StudyError


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in patient space, read-only.

    Attributes:
        vertices: `(V, 3)` float64, mm LPS.
        faces: `(F, 3)` int64, vertex indices, oriented outward.
        case_id: Names the case in messages and tables.

    Raises:
        CaseError: For arrays of other shapes, numbers that are not finite, and faces that name
            missing vertices.

    Examples:
        >>> mesh = Mesh([[0, 0, 0], [30, 0, 0], [0, 40, 0]], [[0, 1, 2]], "liver_7")
        >>> mesh.vertices.dtype, len(mesh.faces)
        (dtype('float64'), 1)
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
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

    `spectral_basis` computes it.

    Attributes:
        case_id: Names the case in messages and tables.
        vertices: `(V, 3)`, unit area.
        faces: `(F, 3)` int.
        eigenvalues: `(K,)`, ascending.
        eigenvectors: `(V, K)`, orthonormal in the mass.
        mass: `(V,)` lumped mass, sum 1.
        laplacian: `(V, V)` sparse, positive semidefinite.
        gradient_x: `(V, V)` sparse, the first tangential component of the gradient at a vertex.
        gradient_y: `(V, V)` sparse, the second tangential component.
        frame: Maps unit area to millimetres.

    Raises:
        CaseError: For numbers that are not finite.
    """

    case_id: str
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    eigenvalues: Float[np.ndarray, " K"]
    eigenvectors: Float[np.ndarray, "V K"]
    mass: Float[np.ndarray, " V"]
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
    """For each template vertex, a point on the surface of a case.

    Attributes:
        template_id: The template.
        case_id: The case.
        case_faces: `(V_t,)` int, the face of the case that holds the point.
        barycentric: `(V_t, 3)`, the point's weights in that face.
        nearest_vertex: `(V_t,)` int, the vertex of the case nearest to the adapted template vertex.
        fitted: `(V_t, 3)` mm, the adapted template X(1, 1) in the case's own space, before it is
            projected onto the surface.
        start: The start of the adaptation: map (as rigid as possible), turned (a rotation by the
            map), rigid, network, mean or as scanned.
        start_reason: Why that start was kept.

    Examples:
        >>> case = Mesh([[0, 0, 0], [30, 0, 0], [0, 40, 0]], [[0, 1, 2]], "b")
        >>> one, halves = np.array([0]), np.array([[0.5, 0.5, 0.0]])
        >>> middle = Correspondence("a", "b", one, halves, one, np.array([[15.0, 0.0, 1.0]]))
        >>> middle.points_on(case)
        array([[15.,  0.,  0.]])
    """

    template_id: str
    case_id: str
    case_faces: Int[np.ndarray, " V"]
    barycentric: Float[np.ndarray, "V 3"]
    nearest_vertex: Int[np.ndarray, " V"]
    fitted: Float[np.ndarray, "V 3"]
    start: str = "rigid"
    start_reason: str = ""

    def points_on(self, case: Mesh) -> np.ndarray:
        """The matched points on the case's surface.

        Args:
            case: The case's mesh.

        Returns:
            `(V_t, 3)` mm.
        """
        return interpolated(case.vertices, case.faces[self.case_faces], self.barycentric)


@dataclass(frozen=True, eq=False)
class ShapePath:
    """The two-parameter family X(t, t_s) = X(t) + t_s Δ_s(t), on the template's faces.

    Attributes:
        template_id: The template.
        case_id: The case.
        times: `(T,)` in [0, 1], ascending.
        pose: `(T, V, 3)` mm, X(t).
        offsets: `(T, V, 3)` mm, Δ_s(t).
        faces: `(F, 3)` int.
    """

    template_id: str
    case_id: str
    times: Float[np.ndarray, " T"]
    pose: Float[np.ndarray, "T V 3"]
    offsets: Float[np.ndarray, "T V 3"]
    faces: Int[np.ndarray, "F 3"]

    def at(self, t: float, t_s: float = 1.0) -> np.ndarray:
        """The shape at a time, linear between the stored times.

        Args:
            t: The time of the pose, in [0, 1].
            t_s: The share of the offset, in [0, 1].

        Returns:
            `(V, 3)` mm.

        Raises:
            ValueError: For t or t_s outside [0, 1].
        """
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
    """N shapes on one template, read-only.

    Attributes:
        vertices: `(N, V, 3)` mm. Vertex v is the same point in all shapes.
        faces: `(F, 3)` int, shared.
        case_ids: The N cases.
        template_id: The case whose mesh has these faces.

    Raises:
        ValueError: For arrays of other shapes.
        StudyError: For two cases with one id.
        CaseError: For a vertex that is not finite.

    Examples:
        >>> triangle = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])
        >>> vertices = np.stack([triangle, 2 * triangle, 3 * triangle])
        >>> shapes = CorrespondedShapes(vertices, np.array([[0, 1, 2]]), ("a", "b", "c"), "b")
        >>> shapes.template[1]
        array([6., 0., 0.])
        >>> shapes.subset([0, 2]).case_ids
        ('a', 'c')
    """

    vertices: Float[np.ndarray, "N V 3"]
    faces: Int[np.ndarray, "F 3"]
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
        """`(V, 3)` mm, the template's own shape; the first case's if the template is left out."""
        in_cohort = self.template_id in self.case_ids
        result: np.ndarray = self.vertices[
            self.case_ids.index(self.template_id) if in_cohort else 0
        ]
        return result

    def subset(self, indices: Sequence[int] | np.ndarray) -> CorrespondedShapes:
        """Some of the cases, on the same template.

        Args:
            indices: The places of the cases, in the order of the result.

        Returns:
            The shapes of these cases.
        """
        chosen = np.asarray(indices, dtype=np.int64)
        case_ids = tuple(self.case_ids[index] for index in chosen)
        return CorrespondedShapes(self.vertices[chosen], self.faces, case_ids, self.template_id)


def refuse_doubled(case_ids: Sequence[str]) -> None:
    """Refuse two cases with one id, because results are looked up by it.

    Raises:
        StudyError: For an id that occurs twice.
    """
    if len(set(case_ids)) == len(case_ids):
        return
    case_id, times = Counter(case_ids).most_common(1)[0]
    raise StudyError(
        f"{times} cases have the id {case_id}; each needs one of its own. Name them where they are "
        "read: read_mesh(path, case_id=...)."
    )


def _read_only(array: np.ndarray, kind: type) -> np.ndarray:
    """A read-only view, without a copy. The caller's own array stays writeable."""
    view: np.ndarray = np.asarray(array, dtype=kind).view()
    view.flags.writeable = False
    return view

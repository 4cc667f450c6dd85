"""The nouns that travel between the rooms of the pipeline, checked on construction.

World space is LPS (left, posterior, superior), in millimetres, everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.similarity import Similarity


class CaseError(ValueError):
    """A case can't be used: says which, what was found, what was needed, what to try."""

    def __init__(self, case_id: str, reason: str) -> None:
        super().__init__(f"case {case_id}: {reason}")
        self.case_id = case_id
        self.reason = reason

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.case_id, self.reason)  # two arguments: survives worker processes


class StudyError(ValueError):
    """A whole study can't run (too few cases, wrong folder, clashing settings)."""


class DamagedFile(StudyError):
    """A file of ours can't be read back: missing, cut short, changed, or of another kind."""

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(
            f"{path} {found}. If a run made it, run the study again: what is damaged or missing is "
            "made again. Otherwise copy it again from where it came."
        )
        self.path, self.found = path, found

    def __reduce__(self) -> tuple[type, tuple[Path, str]]:
        return type(self), (self.path, self.found)  # survives worker processes


@dataclass(frozen=True, eq=False)
class Mask:
    """A binary segmentation in patient space.

    voxels     (Z, Y, X) bool.
    spacing_mm (3,) voxel size along x, y, z; origin_mm (3,) LPS of voxel (0, 0, 0);
    direction  (3, 3), columns are the image axes x, y, z in LPS.
    warnings   what a reader of the report should know of this case.
    labels     (Z, Y, X) int, where the organ is made of several labelled parts; 0 outside.
    """

    voxels: np.ndarray
    spacing_mm: np.ndarray
    origin_mm: np.ndarray
    direction: np.ndarray
    case_id: str
    warnings: tuple[str, ...] = ()
    labels: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.voxels.ndim != 3:
            raise CaseError(
                self.case_id,
                f"the mask has {self.voxels.ndim} dimensions; 3 are needed. "
                "Export one 3D volume per case.",
            )
        if not (np.all(np.isfinite(self.spacing_mm)) and np.all(np.asarray(self.spacing_mm) > 0)):
            raise CaseError(
                self.case_id,
                f"voxel spacing is {tuple(map(float, self.spacing_mm))} mm; finite positive "
                "numbers are needed. Correct the image header.",
            )

    @property
    def volume_mm3(self) -> float:
        return float(self.voxels.sum() * np.prod(self.spacing_mm))

    def to_world(self, index_xyz: np.ndarray) -> np.ndarray:
        """(…, 3) continuous voxel indices in x, y, z order → (…, 3) mm LPS."""
        return (index_xyz * self.spacing_mm) @ np.asarray(self.direction).T + self.origin_mm


@dataclass(frozen=True)
class Surface:
    """A triangle surface as a file gives it: it may be open, doubled, knotted or inside out.

    vertices (V, 3) mm LPS, finite; faces (F, 3) int, F > 0; warnings: as of a Mask.
    """

    vertices: np.ndarray
    faces: np.ndarray
    case_id: str
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        mesh = Mesh(self.vertices, self.faces, self.case_id)  # checks shapes and numbers
        if len(mesh.faces) == 0:
            raise CaseError(
                self.case_id,
                f"the surface has no triangles ({len(mesh.vertices)} points); a surface is needed. "
                "Export it as a triangle mesh.",
            )
        object.__setattr__(self, "vertices", mesh.vertices)
        object.__setattr__(self, "faces", mesh.faces)


@dataclass(frozen=True)
class CaseSource:
    """A case not read yet: its id, the files it rests on, and how to read it.

    patient  whom it is of, where a patient has several cases (two sides, two visits): they are
             kept in one fold. Empty: the case is its own.
    """

    case_id: str
    files: tuple[Path, ...]
    load: Callable[[], Mask | Surface]
    patient: str = ""


@dataclass(frozen=True)
class Dropped:
    """A case left out, at which stage and why."""

    case_id: str
    stage: str
    reason: str


@dataclass(frozen=True, eq=False)
class Cohort:
    """The cases of a study. `truth` is set for synthetic cohorts only."""

    name: str
    cases: tuple[CaseSource, ...]
    dropped: tuple[Dropped, ...] = ()
    truth: PhantomTruth | None = None

    @property
    def is_synthetic(self) -> bool:
        return self.truth is not None


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
class Mesh:
    """A triangle mesh: vertices (V, 3) float64 mm LPS, faces (F, 3) int64, outward oriented."""

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
class SpectralBasis:
    """Laplacian eigenpairs and operators of one mesh, centred and scaled to unit area.

    eigenvalues (K,) ascending; eigenvectors (V, K), mass-orthonormal; mass (V,) lumped, sum 1;
    stiffness (V, V) sparse, positive semidefinite; gradient_x, gradient_y (V, V) sparse: the two
    tangential components of DiffusionNet's per-vertex gradient; frame: unit-area → millimetres.
    """

    case_id: str
    vertices: np.ndarray
    faces: np.ndarray
    eigenvalues: np.ndarray
    eigenvectors: np.ndarray
    mass: np.ndarray
    stiffness: sp.csr_matrix
    gradient_x: sp.csr_matrix
    gradient_y: sp.csr_matrix
    frame: Similarity

    def __post_init__(self) -> None:
        for name in ("eigenvalues", "eigenvectors", "mass", "vertices"):
            finite = np.isfinite(getattr(self, name))
            if not finite.all():
                self._refuse(name, int(np.argwhere(~finite)[0][0]))
        for name in ("stiffness", "gradient_x", "gradient_y"):
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
    in the case's own space, before it is carried onto the surface.
    """

    template_id: str
    case_id: str
    case_faces: np.ndarray
    barycentric: np.ndarray
    nearest_vertex: np.ndarray
    fitted: np.ndarray

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
        return pose + t_s * offset


@dataclass(frozen=True, eq=False)
class CorrespondedShapes:
    """N shapes on one template: vertices (N, V, 3) mm, shared faces (F, 3), case ids. Read-only.

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
        if self.vertices.ndim != 3 or len(self.vertices) != len(self.case_ids):
            raise ValueError(
                f"vertices have shape {self.vertices.shape} for {len(self.case_ids)} cases; "
                "(N, V, 3) is needed"
            )

    @property
    def template(self) -> np.ndarray:
        """(V, 3) mm: the template's own shape; the first case's where the template is left out."""
        in_cohort = self.template_id in self.case_ids
        return self.vertices[self.case_ids.index(self.template_id) if in_cohort else 0]

    def subset(self, indices: Sequence[int] | np.ndarray) -> CorrespondedShapes:
        """The cases at these places, in this order, on the same template."""
        chosen = np.asarray(indices, dtype=np.int64)
        case_ids = tuple(self.case_ids[index] for index in chosen)
        return CorrespondedShapes(self.vertices[chosen], self.faces, case_ids, self.template_id)


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
        return self.values[self.shares.argmax(axis=1)]


@dataclass(frozen=True, eq=False)
class Metrics:
    """Tidy tables by name, units in the column names."""

    tables: dict[str, pd.DataFrame] = field(default_factory=dict)


def _read_only(array: np.ndarray, kind: type) -> np.ndarray:
    """A view that can't be written to; no copy. The caller's own array stays as it is."""
    view: np.ndarray = np.asarray(array, dtype=kind).view()
    view.flags.writeable = False
    return view

"""Cases before meshing: masks, surfaces, their files, and the cases that are left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ssm_pipeline.records.errors import CaseError
from ssm_pipeline.records.shapes import Mesh
from ssm_pipeline.records.truth import PhantomTruth


@dataclass(frozen=True, eq=False)
class Mask:
    """A binary segmentation in patient space.

    A NumPy array becomes a mask as `Mask(array, spacing_mm, origin_mm, direction, "liver_7")`. The
    axes of the array are z, y, x, as SimpleITK gives them; nibabel gives x, y, z, so transpose
    its arrays first. Spacing, origin and direction are in the order x, y, z.

    Attributes:
        voxels: `(Z, Y, X)` bool.
        spacing_mm: `(3,)` voxel size along x, y, z, mm.
        origin_mm: `(3,)` the centre of voxel (0, 0, 0), mm LPS.
        direction: `(3, 3)`, its columns are the image axes x, y, z in LPS.
        case_id: Names the case in messages and tables.
        warnings: What a reader of the report should know about this case.
        labels: `(Z, Y, X)` int, where the organ consists of several labelled parts; 0 outside.

    Raises:
        CaseError: For arrays of other shapes, a voxel size that is not positive, and axes that are
            not at right angles.

    Examples:
        >>> import numpy as np
        >>> voxels = np.zeros((10, 20, 30), dtype=bool)
        >>> voxels[2:8, 5:15, 5:25] = True
        >>> mask = Mask(voxels, [0.5, 0.5, 2.0], [0, 0, 0], np.eye(3), "liver_7")
        >>> mask.volume_mm3
        600.0
    """

    voxels: Bool[np.ndarray, "Z Y X"]
    spacing_mm: Float[np.ndarray, 3]
    origin_mm: Float[np.ndarray, 3]
    direction: Float[np.ndarray, "3 3"]
    case_id: str
    warnings: tuple[str, ...] = ()
    labels: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "voxels", np.asarray(self.voxels, dtype=bool))
        for name in ("spacing_mm", "origin_mm", "direction"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        if self.voxels.ndim != 3:
            raise CaseError(
                self.case_id,
                f"the mask has {self.voxels.ndim} dimensions; 3 are needed. "
                "Export one 3D volume per case.",
            )
        for name, shape in (("spacing_mm", (3,)), ("origin_mm", (3,)), ("direction", (3, 3))):
            found = getattr(self, name).shape
            if found != shape:
                raise CaseError(self.case_id, f"{name} has shape {found}; {shape} is needed.")
        if not (np.all(np.isfinite(self.spacing_mm)) and np.all(self.spacing_mm > 0)):
            raise CaseError(
                self.case_id,
                f"voxel spacing is {tuple(map(float, self.spacing_mm))} mm; finite positive "
                "numbers are needed. Correct the image header.",
            )
        if not np.abs(self.direction.T @ self.direction - np.eye(3)).max() < 1e-3:
            raise CaseError(
                self.case_id,
                "the image axes (direction) are not at right angles; a plain grid is needed. "
                "Resample the image to one.",
            )

    @property
    def volume_mm3(self) -> float:
        """The volume of the voxels, mm³."""
        return float(self.voxels.sum() * np.prod(self.spacing_mm))

    def to_world(self, index_xyz: np.ndarray) -> np.ndarray:
        """Map voxel indices to patient space.

        Args:
            index_xyz: `(…, 3)` continuous indices in the order x, y, z.

        Returns:
            `(…, 3)` mm LPS.
        """
        result: np.ndarray = (index_xyz * self.spacing_mm) @ self.direction.T + self.origin_mm
        return result


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle surface as a file gives it. It may be open, doubled, knotted or inside out.

    Attributes:
        vertices: `(V, 3)` mm LPS, finite.
        faces: `(F, 3)` int, F > 0.
        case_id: Names the case in messages and tables.
        warnings: What a reader of the report should know about this case.

    Raises:
        CaseError: For arrays of other shapes, numbers that are not finite, or no faces.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
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
    """A case that is not read yet.

    Attributes:
        case_id: Names the case in messages and tables.
        files: The files that the case depends on.
        load: Reads the case.
        patient: The patient of the case. The cases of one patient (two sides, two visits) are held
            out together. Empty: no other case is of this patient.
        visit: As the patient table says; empty if it says nothing.
        side: As `visit`.
        site: As `visit`.
    """

    case_id: str
    files: tuple[Path, ...]
    load: Callable[[], Mask | Surface]
    patient: str = ""
    visit: str = ""
    side: str = ""
    site: str = ""


@dataclass(frozen=True)
class Dropped:
    """A case that is left out.

    Attributes:
        case_id: The case.
        stage: The stage that dropped it.
        reason: Why, and what to do about it.
    """

    case_id: str
    stage: str
    reason: str


@dataclass(frozen=True, eq=False)
class Cohort:
    """The cases of a study.

    Attributes:
        name: The name of the cohort.
        cases: The cases, not read yet.
        dropped: The cases that are left out.
        truth: The known truth, for synthetic cohorts only.
    """

    name: str
    cases: tuple[CaseSource, ...]
    dropped: tuple[Dropped, ...] = ()
    truth: PhantomTruth | None = None

    @property
    def is_synthetic(self) -> bool:
        return self.truth is not None

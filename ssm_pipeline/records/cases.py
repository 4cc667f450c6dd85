"""Cases as they come: masks and surfaces, where they are read, which are left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssm_pipeline.records.errors import CaseError
from ssm_pipeline.records.shapes import Mesh
from ssm_pipeline.records.truth import PhantomTruth


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


@dataclass(frozen=True, eq=False)
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

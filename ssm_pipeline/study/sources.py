"""The sources of a study's cases: one class per source, and a list of them at the end.

A new source is a module in `data_prep` that finds its cases, a class here, and a line in the list.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.records import Cohort, StudyError
from ssm_pipeline.settings import Settings

if TYPE_CHECKING:
    from ssm_pipeline.data_prep.cohorts.selection import Choice

Side = Literal["left", "right"]
Unit = Literal["um", "mm", "cm", "m"]


class FolderData(Settings):
    """The settings that all folders of cases share."""

    folder: Path | None = None  # --data sets it
    cases: tuple[str, ...] | None = None  # case ids; None: all
    limit: int | None = Field(None, ge=1)  # cases; None: all
    exclude: Mapping[str, str] = Field({})  # case id: why it is left out; shown beside the case
    patients: Path | None = None  # table: case, patient, visit, side, site; None: from the ids
    mirror: Side | None = None  # the side that is reflected: left and right are one cohort

    @property
    def noun(self) -> str:
        return "masks"

    @property
    def in_words(self) -> str:
        return f"the {self.noun} in {self.folder}"

    @property
    def has_parts(self) -> bool:
        """Whether the organ consists of several labels, whose borders are known."""
        return False

    def find(self, run_folder: Path) -> Cohort:
        """Find the cases. A case is read only when it is loaded. Raises StudyError."""
        raise NotImplementedError

    def case_settings(self) -> dict[str, Any]:
        """Return the settings that change a case itself, not those that select cases."""
        which = {"folder", "cases", "limit", "exclude", "patients", "pattern", "organ", "subset"}
        return self.model_dump(mode="json", exclude=which)

    def _given_folder(self) -> Path:
        if self.folder is None:
            raise StudyError(f"the study needs {self.noun}. Pass --data FOLDER or set data.folder.")
        return self.folder

    def _choice(self) -> Choice:
        from ssm_pipeline.data_prep.cohorts.patients import read_patients
        from ssm_pipeline.data_prep.cohorts.selection import Choice

        patients = {} if self.patients is None else read_patients(self.patients)
        return Choice(self.cases, self.limit, self.mirror, self.exclude, patients)


class Luna16Data(FolderData):
    """Lung masks in LUNA16's own layout; the folder holds seg-lungs-LUNA16, or its files."""

    source: Literal["luna16"] = "luna16"
    side: Literal["left", "right", "both"] = "left"  # lung; cases and limit count scans
    subset: int | None = None  # keep the scans whose CT lies in subset<k> beside the masks
    allow_truncated: bool = True  # keep organs that touch the image border, with a warning

    @model_validator(mode="after")
    def _two_sides_to_mirror(self) -> Luna16Data:
        if self.mirror and self.side != "both":
            raise ValueError(
                f"mirror is {self.mirror}, but side is {self.side}. Set side to both, or mirror to "
                "null"
            )
        return self

    def find(self, run_folder: Path) -> Cohort:
        from ssm_pipeline.data_prep.cohorts import luna16

        return luna16.find_cases(
            self._given_folder(), self.side, self.subset, self.allow_truncated, self._choice()
        )


class MaskFolderData(FolderData):
    """A folder of label images (.nii.gz, .nii, .nrrd, .mhd, .mha) of any organ, or of
    segmentations with named segments (.seg.nrrd, DICOM SEG)."""

    source: Literal["masks"] = "masks"
    labels: tuple[int, ...] = Field((1,), min_length=1)  # parts, united to one organ
    segments: tuple[str, ...] = ()  # names, united, in place of labels: .seg.nrrd and DICOM SEG
    threshold: float | None = None  # for probability maps, in place of labels: organ is above it
    pattern: str | None = None  # glob below the folder, such as */liver.nii.gz; None: its files
    unit: Unit | None = None  # of the files' lengths; None: as stated, else mm if the size fits
    organ: str = "organ"  # its name in messages
    allow_truncated: bool = True  # keep organs that touch the image border, with a warning

    @field_validator("labels")
    @classmethod
    def _no_background(cls, labels: tuple[int, ...]) -> tuple[int, ...]:
        if 0 in labels:
            raise ValueError("label 0 is the background. Give the organ's label")
        return labels

    @property
    def has_parts(self) -> bool:
        if self.segments:
            return len(set(self.segments)) > 1
        return len(set(self.labels)) > 1 and self.threshold is None

    def find(self, run_folder: Path) -> Cohort:
        from ssm_pipeline.data_prep.cohorts import mask_folder

        organ = mask_folder.Organ(
            self.labels,
            self.segments,
            self.threshold,
            self.organ,
            self.allow_truncated,
            self.unit,
        )
        return mask_folder.find_cases(self._given_folder(), organ, self.pattern, self._choice())


class MeshFolderData(FolderData):
    """A folder of surfaces of any organ: .ply, .stl, .obj, .off, .vtk, .vtp, .vtu, .gii,
    FreeSurfer."""

    source: Literal["meshes"] = "meshes"
    unit: Unit | None = None  # of the files' lengths; None: mm, if the size could be an organ's
    space: Literal["LPS", "RAS"] | None = None  # of files that don't say it; None: LPS
    pattern: str | None = None  # glob below the folder, such as */liver.stl; None: its files

    @property
    def noun(self) -> str:
        return "surfaces"

    def find(self, run_folder: Path) -> Cohort:
        from ssm_pipeline.data_prep.cohorts import surface_folder

        return surface_folder.find_cases(
            self._given_folder(), self.pattern, self.unit, self.space, self._choice()
        )


class PhantomData(PhantomSettings):
    """Synthetic organs with known correspondences, made in `<run>/data/phantoms`.

    `seed`, where it is left out, is the study's.
    """

    source: Literal["phantoms"] = "phantoms"

    @property
    def in_words(self) -> str:
        return "synthetic phantoms"

    @property
    def has_parts(self) -> bool:
        return self.family != "smooth"

    def find(self, run_folder: Path) -> Cohort:
        from ssm_pipeline.data_prep.synthetic.phantoms import make_cohort

        return make_cohort(run_folder / "data" / "phantoms", self)

    def case_settings(self) -> dict[str, Any]:
        return {}  # the key of the files is enough


DataSettings = Annotated[
    Luna16Data | MaskFolderData | MeshFolderData | PhantomData, Field(discriminator="source")
]

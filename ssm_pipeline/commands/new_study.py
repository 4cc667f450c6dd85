"""`workflow init`: write the YAML of a new study, with comments on the main settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssm_pipeline import storage
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.sources import MaskFolderData, MeshFolderData
from ssm_pipeline.study.yaml_settings import checked_as

TEMPLATE = """\
# A study: every key is a setting; what is left out has its default.
# `workflow show {name}` prints them all, `workflow run {name}` runs it.
description: {description}
seed: 0                    # of every random draw

data:
{data}
  exclude: {{}}              # {{case_7: motion}} leaves a case out, and says why

meshing:
  faces: 8000              # triangles of each surface

spectral:
  eigenpairs: 120          # of the Laplacian; the built-in weights read so many

training:
  start: built-in          # weights that synthetic shapes trained; none: fresh ones, 1000 steps
  steps: 50                # one pair of cases each
  matching:
    features: xyz+wks      # for scans that lie alike, to about 40 degrees; wks: in any position

shape_model:
  with_scale: false        # true removes size from the model; false keeps it as a mode
"""
# A line a setting: its name, and a comment.
_OF_MASKS = {
    "source": "a folder of label images: .nii.gz, .nii, .nrrd, .mhd, .mha; or .seg.nrrd, DICOM SEG",
    "folder": "",
    "labels": "several are united to one organ",
    "segments": "names, in place of labels, of .seg.nrrd and DICOM SEG",
    "threshold": "in place of labels, of probability maps: organ is what lies above it",
    "pattern": 'glob below the folder, as "*/liver.nii.gz"; null: its files',
    "mirror": "left or right: that side is reflected; null: none",
    "allow_truncated": "false drops organs that touch the image border",
}
_OF_MESHES = {
    "source": "a folder of surfaces: .ply, .stl, .obj, .off, .vtk, .vtp, .vtu, .gii, FreeSurfer",
    "folder": "",
    "unit": "of the files' lengths: um, mm, cm or m; null: as stated, else mm if the size fits",
    "space": "LPS or RAS, of files that don't say it; null: LPS",
    "pattern": 'glob below the folder, as "*/liver.stl"; null: its files',
    "mirror": "left or right: that side is reflected; null: none",
}


def data_of(
    masks: Path | None, meshes: Path | None, given: Mapping[str, Any]
) -> MaskFolderData | MeshFolderData:
    """Return the settings for the options of `init`; None and [] mean the default.

    Raises:
        StudyError: If not exactly one folder is given, or an option does not fit it.
    """
    folder = masks if masks is not None else meshes
    if folder is None or (masks is not None and meshes is not None):
        raise StudyError("give one folder: --masks DIR with label images, or --meshes DIR.")
    wanted = {name: value for name, value in given.items() if value not in (None, [])}
    if meshes is not None:
        return checked_as(MeshFolderData, {"folder": folder, **wanted}, Path("workflow init"))
    if len({"labels", "segments", "threshold"} & set(wanted)) != 1:
        raise StudyError(
            "give only one of --label, --segment and --threshold: they all select the organ."
        )
    return checked_as(MaskFolderData, {"folder": folder, **wanted}, Path("workflow init"))


def write_study(name: str, data: MaskFolderData | MeshFolderData) -> Path:
    """Write `<name>.yaml` to the current directory, for the cases of `data`.

    Returns:
        Its path.

    Raises:
        StudyError: If the folder has no cases, the name contains a path, or the file exists.
    """
    path = Path(f"{name.removesuffix('.yaml').removesuffix('.yml')}.yaml")
    if path.name != str(path) or not name.strip(". "):
        raise StudyError(f"{name} is not a plain name. Give a name without folders: my-study.")
    if path.exists():
        raise StudyError(f"{path} exists. Give another name, or delete it.")
    cohort = data.find(Path())
    assert data.folder is not None  # `find` refuses one without
    content = TEMPLATE.format(
        name=name,
        description=json.dumps(f"{len(cohort.cases)} {data.noun} of {data.folder.name}"),
        data="\n".join(_lines(data)),
    )
    storage.write_text(path, content)
    return path


def _lines(data: MaskFolderData | MeshFolderData) -> list[str]:
    values = data.model_dump(mode="json")
    assert data.folder is not None
    values["folder"] = str(data.folder.resolve())
    comments = _OF_MASKS if isinstance(data, MaskFolderData) else _OF_MESHES
    lines = []
    for key, comment in comments.items():
        setting = f"  {key}: {values[key] if key == 'source' else json.dumps(values[key])}"
        lines.append(f"{setting:<26} # {comment}" if comment else setting)
    return lines

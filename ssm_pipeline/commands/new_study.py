"""`workflow init`: the YAML of a new study, with a comment a setting worth knowing."""

from __future__ import annotations

import json
from pathlib import Path

from data_prep import mask_folder
from ssm_pipeline import storage
from ssm_pipeline.records import StudyError

TEMPLATE = """\
# A study: every key is a setting; what is left out has its default.
# `workflow show {name}` prints them all, `workflow run {name}` runs it.
description: {description}
seed: 0                    # of every random draw

data:
  source: masks            # a folder of label images: .nii.gz, .nii, .nrrd, .mhd, .mha
  folder: {folder}
  labels: {labels}              # several are united to one organ
  pattern: {pattern}            # glob below the folder, as "*/liver.nii.gz"; null: its files
  allow_truncated: true    # false drops organs that touch the image border

meshing:
  faces: 8000              # triangles of each surface

spectral:
  eigenpairs: 200          # of the Laplacian; the matching works in their span

shape_model:
  with_scale: false        # true removes size from the model; false keeps it as a mode
"""


def write_study(name: str, masks: Path, labels: tuple[int, ...], pattern: str | None) -> Path:
    """Write `<name>.yaml` here. Returns its path.

    Raises StudyError for a folder without masks, a name with a path in it, or a file that exists.
    """
    path = Path(f"{name}.yaml")
    if path.name != str(path):
        raise StudyError(f"{name} is not a plain name; give one without folders, as my-study.")
    if path.exists():
        raise StudyError(f"{path} exists. Give another name, or delete it.")
    cohort = mask_folder.find_cases(masks, labels=labels, pattern=pattern)
    content = TEMPLATE.format(
        name=name,
        description=json.dumps(f"{len(cohort.cases)} masks of {masks.name}"),
        folder=json.dumps(str(masks.resolve())),
        labels=list(labels),
        pattern=json.dumps(pattern),
    )
    storage.write_text(path, content)
    return path

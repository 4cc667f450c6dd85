"""What lies in an export, in words: README, model card, BIDS description; a script for Slicer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.counting import counted

# File or folder in an export → what it is, and how it opens.
FILES = {
    "model.npz": "the whole model as arrays: `numpy.load`, or `ssm_pipeline.load_model`",
    "scores.csv": "every case's scores in standard deviations; any spreadsheet, R",
    "modes.csv": "every mode's variance in mm², its share, and the share of all up to it",
    "measurements.csv": "volume, area and extents of every case, the mean, and each mode at ±2 SD",
    "model.glb": "the mean, a morph target per mode; Blender (File, Import), any glTF viewer",
    "model.vtp": "the mean with a vector a mode; ParaView (Warp By Vector), 3D Slicer",
    "model.h5": "Statismo's format 0.9; Scalismo (`StatismoIO.readStatismoPDM`), `workflow import`",
    "meshes": "mean, template and each mode at ±2 SD as PLY; 3D Slicer, MeshLab, ParaView",
    "shapeworks": "every case's surface, particles and alignment; ShapeWorks Studio opens "
    "`model.swproj`",
    "load_in_slicer.py": "shows mean and modes in 3D Slicer; how to run it is in its first lines",
    "MODEL_CARD.md": "what the model was made of, how, and how good it is",
    "dataset_description.json": "what a BIDS derivative says of itself",
    "export.json": "the same facts for programs",
}


@dataclass(frozen=True)
class About:
    """What is said of an export: study's name, how many cases and modes, whether they are synthetic
    or pseudonymised, whether size was removed (None: not known); settings and metrics a line each;
    version: ours."""

    study: str
    cases: int
    modes: int
    modes_for_90: int
    synthetic: bool
    pseudonymised: bool
    size_removed: bool | None
    settings: Mapping[str, object]
    metrics: Sequence[str]
    version: str


def write_about(about: About, folder: Path) -> list[Path]:
    """README.md, MODEL_CARD.md, dataset_description.json and load_in_slicer.py.

    The README names what lies in the folder, so this comes last.

    Returns:
        Them.
    """
    card, bids = folder / "MODEL_CARD.md", folder / "dataset_description.json"
    slicer, readme = folder / "load_in_slicer.py", folder / "README.md"
    storage.write_text(card, model_card(about))
    storage.write_json(bids, dataset_description(about))
    storage.write_text(slicer, SLICER_SCRIPT)
    storage.write_text(readme, readme_text(about, folder))
    return [card, bids, slicer, readme]


SIZE = {
    True: "was removed from the shapes",
    False: "is part of the shape",
    None: "may or may not have been removed: whoever made it knows",
}


def readme_text(about: About, folder: Path) -> str:
    found = [name for name in FILES if (folder / name).exists()]
    lines = [f"- `{name}{'/' * (folder / name).is_dir()}`: {FILES[name]}." for name in found]
    ids = (
        "pseudonyms; whoever made this holds the key" if about.pseudonymised else "as in the study"
    )
    return (
        f"# Shape model {about.study}\n\n"
        f"{'SYNTHETIC PHANTOMS, no patients. ' if about.synthetic else ''}"
        f"A statistical shape model of {counted(about.cases, 'case')} with "
        f"{counted(about.modes, 'mode')}, of which "
        f"{about.modes_for_90} hold 90 % of the variance. Case ids are {ids}.\n\n"
        "All coordinates are millimetres in LPS (left, posterior, superior). A shape is the mean "
        "plus, for each mode, score × √variance × mode.\n\n" + "\n".join(lines) + "\n"
    )


def model_card(about: About) -> str:
    settings = "\n".join(f"- {key}: {value}" for key, value in about.settings.items())
    metrics = "\n".join(f"- {line}" for line in about.metrics) or "- none were computed"
    return (
        f"# Model card: {about.study}\n\n"
        "## Cohort\n\n"
        f"- {counted(about.cases, 'case')}{', synthetic phantoms' if about.synthetic else ''}\n"
        f"- size {SIZE[about.size_removed]}\n"
        "- who they are, how they were chosen, which scanner and which segmentation: to be added "
        "by whoever passes this on\n\n"
        f"## How it was made\n\n- ssm-pipeline {about.version}\n{settings}\n\n"
        f"## How good it is\n\n{metrics}\n\n"
        "## What it is for, and what not\n\n"
        "Research on shape. It describes the cases it was made of and others like them; it is no "
        "medical device, and knows nothing of organs unlike its own.\n\n"
        "## Licence of the data\n\n"
        "A model of masks is bound by the masks' licence. To be added by whoever passes this on; "
        "until then, assume that it may not be passed on.\n"
    )


def dataset_description(about: About) -> dict[str, object]:
    """Source: BIDS specification, derivative datasets."""
    return {
        "Name": f"Statistical shape model {about.study}",
        "BIDSVersion": "1.9.0",
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "ssm-pipeline", "Version": about.version}],
    }


SLICER_SCRIPT = '''"""Shows the model in 3D Slicer. In its Python console:

    import runpy; runpy.run_path("/the/path/of/load_in_slicer.py")
"""

from pathlib import Path

import slicer

folder = Path(__file__).resolve().parent
for path in sorted((folder / "meshes").glob("*.ply")):
    node = slicer.util.loadModel(str(path))  # the files say LPS themselves
    node.GetDisplayNode().SetOpacity(0.6)
    # The mean first; each mode is shown by its eye in the Data module.
    node.GetDisplayNode().SetVisibility(path.stem == "mean")
for path in sorted(folder.rglob("*.mrk.json")):
    slicer.util.loadMarkups(str(path))
slicer.util.resetThreeDViews()
'''

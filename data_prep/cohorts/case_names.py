"""A case's id, from the path of its file below the study's folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

_BIDS_NAME = re.compile(r"sub-[A-Za-z0-9]+(?:_[A-Za-z]+-[A-Za-z0-9+]+)*_[A-Za-z0-9]+")
_BIDS_KEPT = ("sub", "ses", "hemi", "run")  # what tells one case from another


def patient_of(case_id: str) -> str:
    """Whom an id that begins with a BIDS subject is of; '' for others.

    >>> patient_of("sub-01_ses-b"), patient_of("lung_7")
    ('sub-01', '')
    """
    found = re.match(r"sub-[A-Za-z0-9]+(?=_|$)", case_id)
    return found[0] if found else ""


def case_name(path: Path, stem: str, pattern: str | None, with_sides: bool = False) -> str:
    """The id of the case in `path`, whose name without suffix is `stem`.

    A pattern that begins with `sub-` is of a BIDS data set: subject, session, hemisphere and run.
    One that ends in a plain file name, as TotalSegmentator's `*/liver.nii.gz`, names by folder.
    Any other names by file; by folder and file where left and right organs of many folders are
    wanted (`with_sides`, `*/kidney_*.nii.gz`).

    >>> case_name(Path("sub-1/ses-b/anat/sub-1_ses-b_T1w_dseg.nii"), "sub-1_ses-b_T1w_dseg",
    ...           "sub-*/**/*_dseg.nii")
    'sub-1_ses-b'
    >>> case_name(Path("s07/liver.nii.gz"), "liver", "*/liver.nii.gz")
    's07'
    """
    if pattern is None:
        return stem
    parts = PurePosixPath(pattern).parts
    if parts[0].startswith("sub-") and _BIDS_NAME.match(stem):
        entities = [word.partition("-") for word in stem.split("_") if "-" in word]
        return "_".join(f"{key}-{value}" for key, _, value in entities if key in _BIDS_KEPT)
    if len(parts) > 1 and not any(sign in parts[-1] for sign in "*?["):
        return path.parent.name
    return f"{path.parent.name}.{stem}" if with_sides and len(parts) > 1 else stem


def told_apart(names: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """Ids for files that are all called the same: the parts of their paths that differ.

    Names that differ already stay as they are, and so do names whose paths do not tell them apart,
    or lie at different depths.

    >>> layout = [Path(f"s{n}/segmentations/liver.nii.gz") for n in range(2)]
    >>> told_apart(["segmentations", "segmentations"], layout)
    ['s0', 's1']
    """
    folders = [path.parent.parts for path in paths]
    is_bids = any(_BIDS_NAME.match(path.name.split(".")[0]) for path in paths)
    if len(names) < 2 or len(set(names)) > 1 or is_bids or len({*map(len, folders)}) > 1:
        return list(names)
    differing = [parts for parts in zip(*folders, strict=True) if len(set(parts)) > 1]
    found = ["_".join(parts) for parts in zip(*differing, strict=True)]
    return found if len(set(found)) == len(names) else list(names)

"""Left and right organs as one cohort: one side is mirrored, both name their patient."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from ssm_pipeline.records import CaseSource, Mask, StudyError, Surface

Side = Literal["left", "right"]
_WORDS: dict[Side, str] = {"left": "left|lt|lh|l|hemi-l", "right": "right|rt|rh|r|hemi-r"}


def side_in_name(case_id: str) -> tuple[Side | None, str]:
    """The side that a word of an id names, and the id without that word: the patient.

    >>> side_in_name("s01.kidney_left"), side_in_name("sub-01_hemi-R"), side_in_name("lung7")
    (('left', 's01.kidney'), ('right', 'sub-01'), (None, 'lung7'))
    """
    found: list[tuple[Side, re.Match[str]]] = [
        (side, match)
        for side, words in _WORDS.items()
        for match in re.finditer(rf"(?:^|[._ -])({words})(?=$|[._ -])", case_id, re.I)
    ]
    # `hemi-r` also holds `r`; of a name as l_hippocampus_left both words say the same.
    sides = {side for side, _ in found}
    if len(sides) != 1:
        return None, case_id
    longest = max(found, key=lambda item: len(item[1].group()))[1]
    rest = case_id[: longest.start()] + case_id[longest.end() :]
    return found[0][0], rest.strip("._ -")


def is_mirrored(case_id: str, mirrored: str | None) -> bool:
    """Whether a study that mirrors this side holds the case as its mirror image."""
    return mirrored is not None and side_in_name(case_id)[0] == mirrored


def mirror_side(sources: Sequence[CaseSource], mirrored: Side | None) -> list[CaseSource]:
    """The sources, those of one side reflected when loaded (x → −x), each with its patient: the one
    that it has, or the id without its side. None: as they are.

    Raises:
        StudyError: Where an id does not say its side.
    """
    if mirrored is None:
        return list(sources)
    result = []
    for source in sources:
        side, patient = side_in_name(source.case_id)
        if side is None:
            raise StudyError(
                f"data.mirror is {mirrored}, and the id {source.case_id} does not say its side. "
                "Ids need a word left or right (or l, r, lh, rh, hemi-L, hemi-R), set apart by "
                "a dot, dash or underscore."
            )
        load = partial(load_mirrored, source.load) if side == mirrored else source.load
        result.append(replace(source, load=load, patient=source.patient or patient))
    return result


def reflect(case: Mask | Surface) -> Mask | Surface:
    """The mirror image, x → −x in LPS: of a surface the triangles are turned around, too."""
    flip = np.array([-1.0, 1.0, 1.0])
    if isinstance(case, Surface):
        return replace(case, vertices=case.vertices * flip, faces=case.faces[:, ::-1])
    return replace(case, origin_mm=case.origin_mm * flip, direction=flip[:, None] * case.direction)


def load_mirrored(load: Callable[[], Mask | Surface]) -> Mask | Surface:
    """`load`, and the mirror image of what it gives."""
    return reflect(load())

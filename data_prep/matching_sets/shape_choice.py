"""Which shapes of a set are trained on or tested: by number, by list or by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ssm_pipeline.records import Mesh, StudyError


def chosen_shapes(
    option: str, text: str, meshes: Sequence[Mesh], folder: Path, leave_out: Sequence[str] = ()
) -> list[int]:
    """Numbers of the shapes that `text` names, in order.

    Args:
        text: `80:100`, counting from 0, the end left out; or `train_cat.txt`, a file of the folder
            with a name a line, as SMAL_r and DT4D-H come with; or beginnings of names, `dog,fox`:
            SMAL_r by species; or nothing: all.
        option: What to call it in messages.
        leave_out: Names of shapes, or of categories, that never count: SHREC'19's partial shape 40.

    >>> from ssm_pipeline.records import Mesh
    >>> import numpy as np
    >>> names = ["cat1", "dog1", "dog2"]
    >>> meshes = [Mesh([[0, 0, 0]], np.zeros((0, 3), int), name) for name in names]
    >>> chosen_shapes("--test", "dog", meshes, Path())
    [1, 2]
    >>> chosen_shapes("--train", "0:2", meshes, Path())
    [0, 1]
    """
    if not text:
        found = list(range(len(meshes)))
    elif ":" in text:
        found = list(_range(option, text, len(meshes), folder))
    elif text.endswith(".txt"):
        found = _listed(option, folder / text, meshes)
    else:
        found = _named(option, text.split(","), meshes)
    return [
        number
        for number in found
        if not {meshes[number].case_id, meshes[number].case_id.rpartition("/")[0]} & set(leave_out)
    ]


def _range(option: str, text: str, count: int, folder: Path) -> range:
    start, _, stop = text.partition(":")
    if not (start.isdigit() and stop.isdigit() and int(start) < int(stop)):
        raise StudyError(f"{option} {text}: a range such as 80:100 is needed, its end left out.")
    if int(stop) > count:
        raise StudyError(
            f"{option} {text} asked of {count} shapes in {folder}; give a range within 0:{count}."
        )
    return range(int(start), int(stop))


def _listed(option: str, path: Path, meshes: Sequence[Mesh]) -> list[int]:
    if not path.is_file():
        raise StudyError(
            f"{option}: there is no {path}. Give a range such as 80:100, or beginnings of the "
            "shapes' names, as dog,fox."
        )
    numbers = {mesh.case_id: number for number, mesh in enumerate(meshes)}
    lines = path.read_text(encoding="utf-8").split()
    names = [line.removesuffix(".off") for line in lines]
    missing = [name for name in names if name not in numbers]
    if missing:
        raise StudyError(f"{option}: {path} names {missing[0]}, which is no shape of the folder.")
    return [numbers[name] for name in names]


def _named(option: str, beginnings: Sequence[str], meshes: Sequence[Mesh]) -> list[int]:
    for beginning in beginnings:
        if not any(mesh.case_id.startswith(beginning) for mesh in meshes):
            raise StudyError(
                f"{option} {','.join(beginnings)}: no shape's name begins with {beginning}; the "
                f"first is {meshes[0].case_id}. A range such as 80:100 can be given too."
            )
    return [
        number for number, mesh in enumerate(meshes) if mesh.case_id.startswith(tuple(beginnings))
    ]

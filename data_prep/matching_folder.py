"""Shape matching benchmarks in the literature's folder layout: `.off` meshes, `.vts` landmarks.

    <folder>/off/tr_reg_080.off       or <folder>/tr_reg_080.off
    <folder>/corres/tr_reg_080.vts    or the .vts beside the mesh

A `.vts` has one line a vertex of the data set's common template: the number, counted from 1, of
the vertex of this shape that it corresponds to. FAUST_r, SCAPE_r and SMAL_r come so, and DT4D-H
with one more folder level, which is kept in the names.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssm_pipeline.records import CaseError, Mesh, StudyError
from ssm_pipeline.storage import write_text


@dataclass(frozen=True, eq=False)
class MatchingSet:
    """meshes; per mesh, template_to_shape (R,) int from 0: the vertex of that mesh which
    corresponds to each template vertex. Within one set (of DT4D-H: one category) R is the same."""

    meshes: tuple[Mesh, ...]
    template_to_shape: tuple[np.ndarray, ...]

    def subset(self, indices: Sequence[int]) -> MatchingSet:
        """The shapes of a test range, e.g. `range(80, 100)` of FAUST_r."""
        return MatchingSet(
            tuple(self.meshes[i] for i in indices),
            tuple(self.template_to_shape[i] for i in indices),
        )


def read_matching_folder(folder: Path) -> MatchingSet:
    """All shapes of the folder in natural order (`cat2` before `cat10`).

    Raises StudyError without meshes, CaseError naming a shape that can't be read, has no .vts,
    or whose .vts names missing vertices.
    """
    off_folder = folder / "off" if (folder / "off").is_dir() else folder
    paths = sorted(off_folder.rglob("*.off"), key=lambda path: _natural(path.as_posix()))
    if not paths:
        raise StudyError(
            f"{folder}: no .off file found in it or in its folder off/. "
            "Name the folder that holds off/ and corres/."
        )
    meshes, correspondences = [], []
    for path in paths:
        name = path.relative_to(off_folder).with_suffix("").as_posix()
        mesh = read_off(path, name)
        beside = path.with_suffix(".vts")
        corres = folder / "corres" / f"{name}.vts"
        found = next((candidate for candidate in (corres, beside) if candidate.is_file()), None)
        if found is None:
            raise CaseError(
                name, f"no correspondences: neither {corres} nor {beside} exists. Put one there."
            )
        meshes.append(mesh)
        correspondences.append(read_vts(found, mesh))
    return MatchingSet(tuple(meshes), tuple(correspondences))


def read_off(path: Path, case_id: str) -> Mesh:
    """A triangle mesh in the Object File Format; per-vertex and per-face colours are ignored."""
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = (line.split("#", 1)[0].strip() for line in text.splitlines())
    rows = [line.split() for line in lines if line]
    if not rows or rows[0][0] not in ("OFF", "COFF", "NOFF"):
        raise CaseError(case_id, f"{path} doesn't begin with OFF. Export it as an ASCII .off.")
    # The counts follow the keyword, on its line or on the next.
    if len(rows[0]) == 1:
        rows = [[rows[0][0], *(rows[1] if len(rows) > 1 else ())], *rows[2:]]
    counts, body = rows[0][1:], rows[1:]
    if len(counts) < 2 or not all(count.isdecimal() for count in counts[:2]):
        found = " ".join(counts) or "nothing"
        raise CaseError(
            case_id,
            f"{path} gives {found} where the numbers of vertices and faces are needed. "
            "Copy it again.",
        )
    vertex_count, face_count = int(counts[0]), int(counts[1])
    if len(body) < vertex_count + face_count:
        raise CaseError(
            case_id,
            f"{path} announces {vertex_count} vertices and {face_count} faces, but only "
            f"{len(body)} lines follow. The file is cut off: copy it again.",
        )
    face_rows = body[vertex_count : vertex_count + face_count]
    if any(row[0] != "3" for row in face_rows):
        raise CaseError(case_id, f"{path} has faces that aren't triangles. Triangulate it.")
    try:
        vertices = np.array([row[:3] for row in body[:vertex_count]], dtype=np.float64)
        faces = np.array([row[1:4] for row in face_rows], dtype=np.int64).reshape(-1, 3)
    except (ValueError, OverflowError) as error:
        raise CaseError(case_id, f"{path} has a line that isn't numbers: {error}") from error
    return Mesh(vertices.reshape(-1, 3), faces, case_id)


def read_vts(path: Path, mesh: Mesh) -> np.ndarray:
    """(R,) vertices of the mesh, from 0; the file counts from 1."""
    try:
        numbers = np.array(path.read_text(encoding="utf-8").split(), dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise CaseError(mesh.case_id, f"{path} holds more than vertex numbers: {error}") from error
    count = len(mesh.vertices)
    if not len(numbers) or numbers.min() < 1 or numbers.max() > count:
        found = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
        raise CaseError(
            mesh.case_id,
            f"{path} names vertices {found}; 1 to {count} are needed, since a .vts counts from 1. "
            "Check that the file belongs to this mesh.",
        )
    return numbers - 1


def write_matching_folder(
    folder: Path, meshes: Sequence[Mesh], template_to_shape: Sequence[np.ndarray]
) -> None:
    """Write `off/<case>.off` and `corres/<case>.vts`. The correspondences given count from 0."""
    for mesh, vertices in zip(meshes, template_to_shape, strict=True):
        lines = ["OFF", f"{len(mesh.vertices)} {len(mesh.faces)} 0"]
        lines += [" ".join(map(repr, row)) for row in mesh.vertices.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
        write_text(folder / "off" / f"{mesh.case_id}.off", "\n".join(lines) + "\n")
        numbers = "\n".join(str(vertex + 1) for vertex in np.asarray(vertices).tolist())
        write_text(folder / "corres" / f"{mesh.case_id}.vts", numbers + "\n")


def _natural(name: str) -> list[tuple[int, str]]:
    """Sorts runs of digits by their value."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]

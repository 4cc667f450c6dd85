"""Shape matching benchmarks in the folder layouts they are distributed in.

Meshes lie in `<folder>/off/*.off` or in the folder itself; in corres/, or beside the meshes,

    tr_reg_080.vts      one line per vertex of the set's template: the number, from 1, of the vertex
                        of this shape that it corresponds to (FAUST_r, SCAPE_r, SMAL_r)
    mouse/run1.vts      the same, with a template per category; cross_category_corres/cat_mouse.vts
                        has a line per vertex of the template of cat: that of mouse's (DT4D-H)
    3_12.map            a line per vertex of shape 3.off: the corresponding one of 12.off (SHREC'19)
    kid07_ref.vts       a line per vertex of kid07.off: the corresponding one of the first shape,
                        which has no such file (TOPKIDS)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.matching_sets.matching_set import (
    Between,
    CategorySet,
    MatchingSet,
    PairwiseSet,
    ShapesWithTruth,
)
from ssm_pipeline.records import CaseError, KnownPair, Mesh, StudyError
from ssm_pipeline.storage import write_text

_BRIDGES = "cross_category_corres"


def read_matching_folder(folder: Path, between: Between = "all") -> ShapesWithTruth:
    """All shapes of the folder in natural order (`cat2` before `cat10`), in any of the layouts.

    Args:
        between: Which pairs count where shapes come in categories.

    Raises:
        StudyError: Without meshes.
        CaseError: Naming a shape that can't be read, has no correspondences, or whose
            correspondences name missing vertices.
    """
    off_folder = folder / "off" if (folder / "off").is_dir() else folder
    paths = sorted(off_folder.rglob("*.off"), key=lambda path: _natural(path.as_posix()))
    if not paths:
        raise StudyError(
            f"{folder}: no .off file found in it or in its folder off/. "
            "Name the folder that holds off/ and corres/."
        )
    names = [path.relative_to(off_folder).with_suffix("").as_posix() for path in paths]
    meshes = tuple(read_off(path, name) for path, name in zip(paths, names, strict=True))
    corres = folder / "corres" if (folder / "corres").is_dir() else off_folder
    maps = sorted(corres.glob("*.map"), key=lambda path: _natural(path.name))
    if maps:
        return PairwiseSet(meshes, tuple(_read_map(path, meshes) for path in maps))
    if any(corres.glob("*_ref.vts")):
        return PairwiseSet(meshes, tuple(_onto_the_first(corres, meshes)))
    templates = tuple(
        read_vts(_vts_of(corres, path, mesh), mesh)
        for path, mesh in zip(paths, meshes, strict=True)
    )
    bridges = {path.stem: path for path in sorted((corres / _BRIDGES).glob("*.vts"))}
    categories = tuple(name.rpartition("/")[0] for name in names)
    several_templates = len({len(vertices) for vertices in templates}) > 1
    if bridges or (several_templates and len(set(categories)) > 1):
        return _in_categories(meshes, categories, templates, bridges, between)
    return MatchingSet(meshes, templates)


def _vts_of(corres: Path, off: Path, mesh: Mesh) -> Path:
    candidates = (corres / f"{mesh.case_id}.vts", off.with_suffix(".vts"))
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        raise CaseError(
            mesh.case_id,
            f"no correspondences: neither {candidates[0]} nor {candidates[1]} exists. Put one "
            "there.",
        )
    return found


def _read_map(path: Path, meshes: Sequence[Mesh]) -> KnownPair:
    numbers = {mesh.case_id: number for number, mesh in enumerate(meshes)}
    first, _, second = path.stem.partition("_")
    if first not in numbers or second not in numbers:
        raise StudyError(
            f"{path}: there are no shapes {first} and {second}. A map's name is that of its two "
            "shapes, as 3_12.map of 3.off and 12.off."
        )
    x, y = numbers[first], numbers[second]
    on_y = read_vts(path, meshes[y])
    return KnownPair(x, y, _every_vertex(path, on_y, meshes[x]), on_y)


def _onto_the_first(corres: Path, meshes: Sequence[Mesh]) -> list[KnownPair]:
    pairs = []
    for y, mesh in enumerate(meshes[1:], start=1):
        path = corres / f"{mesh.case_id}_ref.vts"
        if not path.is_file():
            raise CaseError(mesh.case_id, f"no correspondences: there is no {path}. Put it there.")
        on_x = read_vts(path, meshes[0])
        pairs.append(KnownPair(0, y, on_x, _every_vertex(path, on_x, mesh)))
    return pairs


def _every_vertex(path: Path, other: np.ndarray, mesh: Mesh) -> np.ndarray:
    if len(other) != len(mesh.vertices):
        raise CaseError(
            mesh.case_id,
            f"{path} has {len(other)} lines for {len(mesh.vertices)} vertices; one per vertex is "
            "needed. Check that the file belongs to this mesh.",
        )
    return np.arange(len(other))


def _in_categories(
    meshes: tuple[Mesh, ...],
    categories: tuple[str, ...],
    templates: tuple[np.ndarray, ...],
    bridges: dict[str, Path],
    between: Between,
) -> CategorySet:
    sizes = {category: len(own) for category, own in zip(categories, templates, strict=True)}
    for mesh, category, own in zip(meshes, categories, templates, strict=True):
        if len(own) != sizes[category]:
            raise CaseError(
                mesh.case_id,
                f"correspondences for {len(own)} template vertices; another shape of {category} "
                f"has {sizes[category]}. Check its .vts.",
            )
    found = {}
    for name, path in bridges.items():
        first, _, second = name.partition("_")
        if first not in sizes or second not in sizes:
            continue  # of categories that were left out of this copy
        try:
            bridge = _numbers(path)
        except (ValueError, OverflowError) as error:
            raise StudyError(f"{path} holds more than vertex numbers: {error}") from error
        if len(bridge) != sizes[first] or bridge.min() < 1 or bridge.max() > sizes[second]:
            raise StudyError(
                f"{path} has {len(bridge)} lines; {sizes[first]}, each with a number from 1 to "
                f"{sizes[second]}, are needed: the templates of {first} and {second}."
            )
        found[first, second] = bridge - 1
    return CategorySet(meshes, categories, templates, found, between)


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
        numbers = _numbers(path)
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
    folder: Path,
    meshes: Sequence[Mesh],
    correspondences: Sequence[np.ndarray] = (),
    onto_the_first: bool = False,
) -> None:
    """Write `off/<case>.off` and `corres/<case>.vts`, or `<case>_ref.vts` as TOPKIDS has them.

    Args:
        correspondences: per mesh, counting from 0, the vertex of it for each vertex of the set's
            template, or `onto_the_first`, for each vertex of it the vertex of the first shape.
            None at all: the meshes alone, as the first shape of TOPKIDS.
    """
    for number, mesh in enumerate(meshes):
        lines = ["OFF", f"{len(mesh.vertices)} {len(mesh.faces)} 0"]
        lines += [" ".join(map(repr, row)) for row in mesh.vertices.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
        write_text(folder / "off" / f"{mesh.case_id}.off", "\n".join(lines) + "\n")
        if correspondences:
            name = f"{mesh.case_id}{'_ref' * onto_the_first}.vts"
            numbers = (np.asarray(correspondences[number]) + 1).tolist()
            write_text(folder / "corres" / name, "\n".join(map(str, numbers)) + "\n")


def _numbers(path: Path) -> np.ndarray:
    return np.array(path.read_text(encoding="utf-8").split(), dtype=np.int64)


def _natural(name: str) -> list[tuple[int, str]]:
    """Sorts runs of digits by their value."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]

"""A surface as a file gives it → a closed, outward oriented manifold, or a reason why not."""

from __future__ import annotations

import igl
import numpy as np
import pymeshlab
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ssm_pipeline.counting import counted
from ssm_pipeline.geometry.surface import area, face_areas, volume
from ssm_pipeline.geometry.topology import boundary_edges, face_components, is_oriented_manifold
from ssm_pipeline.records import CaseError, Mesh, Surface

TOLD_PERCENT = 1.0  # of the surface: smaller stray pieces are left out without a message
WELD = 1e-5  # of the surface's diagonal: open edges nearer than that are one edge
KNOTTED_PERCENT = 5.0  # of the triangles: more that cut through others have no inside


def repair(surface: Surface, hole_percent: float) -> tuple[Mesh, tuple[str, ...]]:
    """The largest piece of a surface, closed and oriented outward, and what was done.

    Equal and nearly equal vertices are merged, triangles without area and duplicates dropped, edges
    of three triangles cut out, faces oriented alike, holes up to `hole_percent` of the surface's
    area closed by a fan.

    Raises:
        CaseError: For a larger hole, a surface without volume, or one that cuts through itself over
            much of its area.
    """
    case_id = surface.case_id
    told: list[str] = []
    vertices, faces = _plain_triangles(surface.vertices, surface.faces)
    if len(faces) < 4:
        raise CaseError(
            case_id,
            f"{len(faces)} triangles with an area are left of {len(surface.faces)}; a closed "
            "surface needs at least 4. Export it again.",
        )
    vertices, faces, cut = _without_knots(vertices, faces)
    if cut:
        told.append(
            f"{counted(cut, 'triangle', 'triangles')} on edges of three or more triangles removed"
        )
    vertices, faces, left_out = _largest_piece(vertices, faces)
    if left_out >= TOLD_PERCENT:
        told.append(f"stray pieces, {left_out:.0f} % of the surface, are left out")
    faces, _ = igl.bfs_orient(np.ascontiguousarray(faces))
    vertices, faces, closed = _close_holes(vertices, faces, hole_percent, case_id)
    if closed:
        told.append(f"{closed} small hole{'s' * (closed > 1)} closed")
    enclosed = volume(vertices, faces)
    if enclosed < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
        if _volume_as_given(surface) < 0:
            told.append("the faces pointed inward and were reversed")
    if not is_oriented_manifold(faces):
        raise CaseError(
            case_id,
            "the surface is not closed and two-sided even after repair (a Möbius band, or "
            "edges of three triangles). Repair it with MeshLab, or make it again from the mask.",
        )
    if abs(enclosed) < 1e-3 * area(vertices, faces) ** 1.5 / 10:
        raise CaseError(
            case_id,
            f"the surface of {area(vertices, faces):.4g} mm² encloses {abs(enclosed):.3g} mm³: a "
            "sheet or a double wall, not a solid organ. Export the organ's outer surface.",
        )
    mesh = Mesh(vertices, faces, case_id)
    knotted = 100 * self_intersections(mesh) / len(faces)
    if knotted > KNOTTED_PERCENT:
        raise CaseError(
            case_id,
            f"{knotted:.0f} % of the triangles cut through others; at most {KNOTTED_PERCENT:g} % "
            "are taken. Repair the surface, or make it again from the mask.",
        )
    if knotted > 0:
        told.append(f"{knotted:.2g} % of the triangles cut through others")
    return mesh, tuple(told)


def self_intersections(mesh: Mesh) -> int:
    """How many triangles cut through others that they share no vertex with."""
    meshes = _meshlab(mesh.vertices, mesh.faces)
    meshes.compute_selection_by_self_intersections_per_face()
    return int(meshes.current_mesh().selected_face_number())


def _plain_triangles(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal vertices merged; triangles with two equal corners, or given twice, dropped.

    Vertices along open edges are also merged within WELD of the surface's size: a file of
    separate triangles, written after a transform, has corners that differ in the last digit.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    faces = _distinct(inverse.ravel()[faces])
    if len(faces) == 0:
        return vertices, faces
    open_edges = boundary_edges(faces)
    if len(open_edges) == 0:
        return vertices, faces
    lengths = np.linalg.norm(vertices[open_edges[:, 0]] - vertices[open_edges[:, 1]], axis=1)
    size = np.linalg.norm(np.ptp(vertices[np.unique(faces)], axis=0))
    tolerance = min(WELD * float(size), 0.1 * float(np.median(lengths)))
    on_edge = np.unique(open_edges)
    pairs = cKDTree(vertices[on_edge]).query_pairs(tolerance, output_type="ndarray")
    if len(pairs) == 0:
        return vertices, faces
    graph = sp.coo_array((np.ones(len(pairs), bool), on_edge[pairs].T), shape=(len(vertices),) * 2)
    group = connected_components(graph, directed=False)[1]
    _, first = np.unique(group, return_index=True)
    return vertices[first], _distinct(group[faces])


def _distinct(faces: np.ndarray) -> np.ndarray:
    """The triangles with three different corners, each once."""
    ordered = np.sort(faces, axis=1)
    proper = (np.diff(ordered, axis=1) != 0).all(axis=1)
    faces, ordered = faces[proper], ordered[proper]
    _, first = np.unique(ordered, axis=0, return_index=True)
    return faces[np.sort(first)]


def _without_knots(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Edges of three or more triangles are cut out, vertices where two sheets touch are split."""
    before = len(faces)
    meshes = _meshlab(vertices, faces)
    meshes.meshing_repair_non_manifold_edges(method="Remove Faces")
    meshes.meshing_repair_non_manifold_vertices(vertdispratio=0)
    result = meshes.current_mesh()
    faces = result.face_matrix().astype(np.int64)
    return result.vertex_matrix(), faces, before - len(faces)


def _largest_piece(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The connected piece of largest area, and the share of the area left out, percent."""
    piece = face_components(faces)
    areas = np.bincount(piece, weights=face_areas(vertices, faces))
    used, local = np.unique(faces[piece == areas.argmax()], return_inverse=True)
    left_out = 100 * (1 - areas.max() / max(areas.sum(), 1e-300))
    return vertices[used], local.reshape(-1, 3).astype(np.int64), float(left_out)


def _close_holes(
    vertices: np.ndarray, faces: np.ndarray, hole_percent: float, case_id: str
) -> tuple[np.ndarray, np.ndarray, int]:
    """Every hole closed by a fan about its middle.

    Raises:
        CaseError: For a large one.
    """
    loops = _boundary_loops(faces)
    total = area(vertices, faces)
    fans, centres = [], []
    shares = []
    for number, loop in enumerate(loops):
        centre = vertices[loop].mean(axis=0)
        hub = len(vertices) + number
        # The neighbour across has the edge the other way around.
        fan = np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), hub)])
        points = np.vstack([vertices, np.zeros((number, 3)), centre])
        shares.append(100 * area(points, fan) / total)
        fans.append(fan)
        centres.append(centre)
    if shares and max(shares) > hole_percent:
        large = sum(share > hole_percent for share in shares)
        raise CaseError(
            case_id,
            f"the surface has {counted(len(loops), 'hole')}, {large} of them large: the largest "
            f"would be {max(shares):.1f} % of the surface; holes up to {hole_percent:g} % are "
            "closed. A large hole often means that the organ is cut off. Close it, or raise "
            "meshing.hole_percent.",
        )
    if fans:
        vertices = np.vstack([vertices, centres])
        faces = np.concatenate([faces, *fans])
    return vertices, faces, len(loops)


def _boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """The vertices along each boundary of an oriented surface, in the faces' direction."""
    following = dict(boundary_edges(faces).tolist())
    loops = []
    while following:
        start, here = following.popitem()
        loop = [start]
        while here != start:
            loop.append(here)
            here = following.pop(here, start)  # a chain that ends is closed as it is
        loops.append(np.array(loop))
    return loops


def _volume_as_given(surface: Surface) -> float:
    return volume(surface.vertices - surface.vertices.mean(axis=0), surface.faces)


def _meshlab(vertices: np.ndarray, faces: np.ndarray) -> pymeshlab.MeshSet:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
    return meshes

"""Surface file → Mesh: PLY, STL, OBJ, OFF, VTK, GIFTI and FreeSurfer."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline.data_prep.formats.brain_surfaces import (
    is_freesurfer,
    read_freesurfer,
    read_gifti,
)
from ssm_pipeline.data_prep.formats.damaged import damaged
from ssm_pipeline.data_prep.formats.image_files import is_file_or_link
from ssm_pipeline.data_prep.formats.ply_strips import has_strips, read_strips
from ssm_pipeline.data_prep.formats.vtk_surface import UnreadableSurface, read_vtk
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import boundary_edges
from ssm_pipeline.records import CaseError, Mesh, require_type

SUFFIXES = (".ply", ".stl", ".obj", ".off", ".vtk", ".vtp", ".vtu", ".gii")
SURFACE_FORMATS = f"{', '.join(SUFFIXES)}, FreeSurfer's lh.pial"
_VTK = (".vtk", ".vtp", ".vtu")
RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
WELD_SHARE = 1e-5  # of the diagonal: single precision at 10 times the size
_HEADER_BYTES = 4096  # where 3D Slicer's note of the coordinate system stands


def is_surface(path: Path) -> bool:
    """True for surface files; False for hidden files such as macOS's `._case.stl`.

    A link to a file that does not exist counts too, so that the case is reported as left out.
    """
    if path.name.startswith(".") or not is_file_or_link(path):
        return False
    return path.suffix.lower() in SUFFIXES or (path.is_file() and is_freesurfer(path))


def surface_stem(path: Path) -> str:
    """The file's name without the suffix; the whole name of a FreeSurfer surface.

    >>> [surface_stem(Path(name)) for name in ("lung.STL", "lh.surf.gii", "lh.pial")]
    ['lung', 'lh', 'lh.pial']
    """
    if path.suffix.lower() not in SUFFIXES:
        return path.name
    return re.sub(r"\.surf$", "", path.stem) if path.suffix.lower() == ".gii" else path.stem


def read_mesh(path: str | Path, case_id: str | None = None) -> Mesh:
    """Read one surface: .ply, .stl, .obj, .off, .vtk, .vtp, .vtu, .gii, or a FreeSurfer surface.

    Args:
        path: The file.
        case_id: Names the case in messages and tables. None: the file's name.

    Returns:
        The vertices as the file numbers them, and the faces cut into triangles. An STL file numbers
        none, so its equal corners become one vertex. A file that says `SPACE=RAS`, as older
        versions of 3D Slicer write, is rotated to LPS, and so are GIFTI and FreeSurfer surfaces,
        which are RAS; the latter are moved to scanner coordinates by the centre that the file
        holds. Other files are taken as they are. Millimetres are assumed. A closed
        surface whose faces look inward has them turned outward.

    Raises:
        TypeError: For anything but one path.
        CaseError: For a file that is missing, damaged, of another kind, or without faces.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("case_7.off").write_text(
        ...     "OFF 4 4 0\\n0 0 0\\n9 0 0\\n0 9 0\\n0 0 9\\n"
        ...     "3 0 2 1\\n3 0 1 3\\n3 1 2 3\\n3 0 3 2\\n"
        ... )
        >>> mesh = read_mesh("case_7.off")
        >>> mesh.case_id, mesh.vertices.shape, mesh.faces.shape
        ('case_7', (4, 3), (4, 3))
    """
    require_type(path, (str, Path), "path", "Read several files one by one.")
    path = Path(path)
    case_id = case_id or surface_stem(path)
    vertices, faces, space = read_triangles(path, case_id)
    mesh = Mesh(vertices * RAS_TO_LPS if space == "RAS" else vertices, faces, case_id)
    if volume(mesh.vertices, mesh.faces) < 0 and not len(boundary_edges(mesh.faces)):
        mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1], case_id)
    return mesh


def read_triangles(path: Path, case_id: str) -> tuple[np.ndarray, np.ndarray, str | None]:
    """Vertices (V, 3) and faces (F, 3) as the file has them, and the space that it states.

    The space is "LPS", "RAS" or None; equal corners of an STL file are one vertex.

    Raises:
        CaseError: As `read_mesh` does.
    """
    suffix = path.suffix.lower()
    brain = suffix == ".gii" or (suffix not in SUFFIXES and is_freesurfer(path))
    if suffix not in SUFFIXES and not brain:
        raise CaseError(
            case_id, f"{path.name} is no surface that can be read; {SURFACE_FORMATS} can."
        )
    if not path.is_file():
        raise CaseError(case_id, f"there is no file {path}. Check the folder and the file name.")
    space: str | None = "RAS" if brain else None
    try:
        if suffix in _VTK:
            vertices, faces, space = read_vtk(path)
        elif brain:
            vertices, faces = read_gifti(path) if suffix == ".gii" else read_freesurfer(path)
        else:
            vertices, faces = _read_trimesh(path, case_id)
    except UnreadableSurface as error:
        raise damaged(path, case_id, str(error)) from error
    if not len(faces):
        raise CaseError(
            case_id,
            f"{path.name} holds {len(vertices)} points and no faces; a surface of triangles is "
            "needed. Export the surface, not its points or lines.",
        )
    if suffix == ".stl":
        vertices, faces = _merged(vertices, faces)
        if len(boundary_edges(faces)):
            vertices, faces = _welded(vertices, faces)
    return vertices, faces, space or _space_in_header(path)


def _read_trimesh(path: Path, case_id: str) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    content = path.read_bytes()
    is_stl = path.suffix.lower() == ".stl"
    if is_stl and content.lstrip()[:5] == b"SOLID" and b"\0" not in content[:_HEADER_BYTES]:
        content = content.lower()  # trimesh knows the words of a text in small letters only
    if is_stl and (missing := _missing_of_stl(content)):
        raise damaged(path, case_id, missing)
    is_ply = path.suffix.lower() == ".ply"
    try:
        if is_ply and has_strips(content):
            return read_strips(content)
        # process=False: vertices stay as the file numbers them.
        read: Any = trimesh.load(
            io.BytesIO(content) if is_stl else path,
            file_type="stl" if is_stl else None,
            force="mesh",
            process=False,
            maintain_order=True,
        )
        vertices = np.asarray(read.vertices).reshape(-1, 3)
        faces = np.asarray(getattr(read, "faces", ())).reshape(-1, 3)
    except Exception as error:  # its readers raise whatever the damage happens to break
        raise damaged(path, case_id, str(error)) from error
    for name, found, promised in zip(
        ("vertices", "faces"),
        (len(vertices), len(faces)),
        _promised_counts(path, content),
        strict=True,
    ):
        if found < promised:
            raise damaged(path, case_id, f"it holds {found} {name} and promises {promised}")
    return vertices, faces


def _missing_of_stl(content: bytes) -> str:
    """What is missing of an STL file; '' if it is whole."""
    if content.lstrip().startswith(b"solid") and b"\0" not in content[:_HEADER_BYTES]:
        last = content.rstrip().rsplit(b"\n", 1)[-1].strip()
        return "" if last.startswith(b"endsolid") else "its last line is not endsolid"
    promised = 84 + 50 * int.from_bytes(content[80:84], "little")
    return f"{len(content)} bytes of {promised}" if len(content) < promised else ""


def _promised_counts(path: Path, content: bytes) -> tuple[int, int]:
    """The numbers of vertices and faces that a PLY or OFF file's header gives; 0 where none does.

    trimesh reads what there is of a text that ends early. An .obj gives no numbers: one cut
    between two lines can't be told from a whole one.
    """
    pattern = {
        ".ply": rb"element vertex (\d+).*?element face (\d+).*?end_header",
        ".off": rb"OFF(?:\s|#[^\n]*\n)*(\d+)\s+(\d+)",
    }.get(path.suffix.lower())
    found = re.search(pattern, content[:_HEADER_BYTES], re.DOTALL) if pattern else None
    return (int(found[1]), int(found[2])) if found else (0, 0)


def _merged(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal vertices become one, in the order of their first use."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    place = np.argsort(np.argsort(first))
    faces = place[inverse.ravel()][faces]
    return vertices[np.sort(first)], faces


def _welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners that differ by a rounding error become one: the first of each group.

    Triangles that lose a corner are left out.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    reach = WELD_SHARE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not reach < 1e100:  # not finite, or beyond what squared distances can hold
        return vertices, faces
    pairs = cKDTree(vertices).query_pairs(reach, output_type="ndarray")
    count = len(vertices)
    near = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (count, count))
    _, group = connected_components(near, directed=False)
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    faces = inverse.ravel()[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return vertices[first], faces[whole]


def _space_in_header(path: Path) -> str | None:
    """ "LPS" or "RAS", by 3D Slicer's note in the header; None without one."""
    with path.open("rb") as file:
        found = re.search(rb"SPACE=(LPS|RAS)\b", file.read(_HEADER_BYTES))
    return found[1].decode() if found else None

"""What `fuzz.py` breaks, I: files that other programs and people write."""

from __future__ import annotations

import faulthandler
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import SimpleITK as sitk
from fuzz_reader import GZIP, Reader

from ssm_pipeline.records import Mask


def write_image(folder: Path, name: str, compressed: bool = False) -> Path:
    z, y, x = np.indices((9, 10, 11)) - 5
    image = sitk.GetImageFromArray(((x**2 + y**2 + z**2 < 14) * 3).astype(np.int16))
    image.SetSpacing((1.0, 1.5, 2.0))
    sitk.WriteImage(image, str(folder / name), compressed)
    return folder / name


def write_zraw(folder: Path) -> Path:
    return write_image(folder, "a.mhd", compressed=True).with_suffix(".zraw")


def read_organ(path: Path) -> object:
    from ssm_pipeline.data_prep.formats.images import read_organ

    return read_organ(path, (3,), "case")


def image_reader(name: str, file: str, compressed: bool = False) -> Reader:
    return Reader(name, lambda folder: write_image(folder, file, compressed), read_organ)


def _two_segments() -> tuple[Mask, dict[str, np.ndarray]]:
    z, y, x = np.indices((8, 9, 10)) - 4
    ball = x**2 + y**2 + z**2 < 14
    mask = Mask(ball, np.array([1.0, 1.5, 2.0]), np.zeros(3), np.eye(3), "case")
    return mask, {"left lung": ball, "right lung": np.roll(ball, 1, axis=2)}


def write_slicer(folder: Path) -> Path:
    from seg_files import write_seg_nrrd

    mask, segments = _two_segments()
    return write_seg_nrrd(folder / "a.seg.nrrd", mask, segments)


def write_dicom(folder: Path) -> Path:
    from seg_files import write_dicom_seg

    mask, segments = _two_segments()
    return write_dicom_seg(folder / "a.dcm", mask, segments)


def read_segments(path: Path) -> object:
    from ssm_pipeline.data_prep.formats.segments import is_segmentation, read_segments

    is_segmentation(path)
    return read_segments(path, ("left lung",), "case")


def write_surface(folder: Path, name: str) -> Path:
    import pyvista

    ball = pyvista.Sphere(theta_resolution=6, phi_resolution=6)
    (ball.cast_to_unstructured_grid() if name.endswith(".vtu") else ball).save(folder / name)
    return folder / name


def write_trimesh(folder: Path, name: str) -> Path:
    import trimesh

    trimesh.creation.icosphere(subdivisions=1).export(folder / name)
    return folder / name


def read_surface(path: Path) -> object:
    from ssm_pipeline.data_prep.formats.surface_files import read_mesh

    return read_mesh(path)


def read_vtk(path: Path) -> object:
    """`read_surface`, whose process for VTK is a fork of this one: starting Python ten thousand
    times would take hours."""
    from ssm_pipeline.data_prep.formats import vtk_surface

    with patch.object(vtk_surface, "subprocess", _Forking):
        return read_surface(path)


class _Forking:
    """Stands in for the module `subprocess` in `vtk_surface`."""

    TimeoutExpired = subprocess.TimeoutExpired

    @staticmethod
    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        import vtkmodules.util.numpy_support
        import vtkmodules.vtkFiltersCore
        import vtkmodules.vtkFiltersGeometry
        import vtkmodules.vtkIOLegacy
        import vtkmodules.vtkIOXML  # noqa: F401

        from ssm_pipeline.data_prep.formats import vtk_surface

        read_end, write_end = os.pipe()
        child = os.fork()
        if child == 0:
            faulthandler.disable()  # a crash of this process is an answer, and no news
            os.dup2(write_end, 1)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            code = 1
            try:
                sys.argv = command[1:]
                code = vtk_surface.main()
                sys.stdout.flush()
            finally:
                os._exit(code)
        os.close(write_end)
        with os.fdopen(read_end) as file:
            said = file.read()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return subprocess.CompletedProcess(command, code, said, "")


def surface_reader(name: str, write: Callable[[Path, str], Path]) -> Reader:
    file = f"a.{name}"
    read = read_vtk if name in ("vtk", "vtp", "vtu") else read_surface
    return Reader(f"surface {name}", lambda folder: write(folder, file), read)


def write_ascii(folder: Path, name: str) -> Path:
    import trimesh

    path = folder / name
    kind = {".stl": "stl_ascii", ".ply": "ply"}[path.suffix]
    ball = trimesh.creation.icosphere(subdivisions=1)
    content = ball.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {}))
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def write_matching(folder: Path) -> Path:
    from ssm_pipeline.data_prep.matching_sets.matching_folder import write_matching_folder
    from ssm_pipeline.records import Mesh

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    write_matching_folder(folder, [Mesh(corners, faces, "a")], [np.arange(4)])
    return folder / "off" / "a.off"


def read_matching(path: Path) -> object:
    from ssm_pipeline.data_prep.matching_sets.matching_folder import read_matching_folder

    return read_matching_folder(path.parents[1])


def write_vts(folder: Path) -> Path:
    write_matching(folder)
    return folder / "corres" / "a.vts"


def write_study(folder: Path) -> Path:
    built_in = Path(__file__).parents[1] / "workflows" / "luna16.yaml"
    path = folder / "study.yaml"
    path.write_bytes(built_in.read_bytes())
    return path


def read_study(path: Path) -> object:
    from ssm_pipeline.study.study import read_study

    return read_study(str(path))


def write_markups(folder: Path) -> Path:
    points = [{"label": "apex", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"}]
    markups = [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": points}]
    path = folder / "points.mrk.json"
    path.write_text(json.dumps({"markups": markups}))
    return path


def read_markups(path: Path) -> object:
    from ssm_pipeline.data_prep.formats.landmarks import read_landmarks

    return read_landmarks(path)


def write_fcsv(folder: Path) -> Path:
    path = folder / "points.fcsv"
    path.write_text(
        "# CoordinateSystem = LPS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,"
        "associatedNodeID\n1,1,2,3,0,0,0,1,1,1,0,apex,,,2,0\n"
    )
    return path


def write_workbook(folder: Path) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["case_id", "sex", "age"])
    for number, case_id in enumerate(CASE_IDS):
        book.active.append([case_id, "fm"[number % 2], 40 + number])
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx"


CASE_IDS = tuple(f"{number:03d}" for number in range(20))


def write_covariates(folder: Path, name: str) -> Path:
    separator = "\t" if name.endswith(".tsv") else ","
    rows = [["case_id", "sex", "age"]]
    rows += [[case_id, "fm"[int(case_id) % 2], str(40 + int(case_id))] for case_id in CASE_IDS]
    (folder / name).write_text("\n".join(map(separator.join, rows)) + "\n")
    return folder / name


def read_covariates(path: Path) -> object:
    from ssm_pipeline.data_prep.formats.tables import read_table, typed
    from ssm_pipeline.statistics.covariates import design_of, matched_to_cases

    table = read_table(path)
    table = typed(table, [name for name in ("age", "sex") if name in table])
    return design_of("~ sex + age", matched_to_cases(table, CASE_IDS))


def write_statismo(folder: Path) -> Path:
    from fuzz_own_files import write_model

    from ssm_pipeline.export.statismo import write_statismo
    from ssm_pipeline.shape_model.model import load_model

    write_statismo(load_model(write_model(folder)), folder / "a.h5", "today")
    return folder / "a.h5"


def read_statismo(path: Path) -> object:
    from ssm_pipeline.export.statismo_reading import read_statismo

    return read_statismo(path)


def write_h5_json(folder: Path) -> Path:
    from hdf5_json_files import as_json

    return as_json(write_statismo(folder))


def _ball() -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def write_gifti(folder: Path) -> Path:
    from brain_files import write_gifti

    return write_gifti(folder / "a.surf.gii", *_ball())


def write_freesurfer(folder: Path) -> Path:
    from brain_files import write_freesurfer

    return write_freesurfer(folder / "lh.pial", *_ball())


def write_strips(folder: Path, binary: bool) -> Path:
    from brain_files import write_ply_strips

    return write_ply_strips(folder / "a.ply", binary)


OUTSIDE_FILES = (
    image_reader("nii", "a.nii"),
    image_reader("nii.gz", "a.nii.gz"),
    Reader("nii in gz", lambda folder: write_image(folder, "a.nii.gz"), read_organ, GZIP),
    image_reader("mha", "a.mha"),
    image_reader("mha compressed", "a.mha", compressed=True),
    image_reader("mhd", "a.mhd"),
    Reader("zraw", write_zraw, lambda path: read_organ(path.with_suffix(".mhd"))),
    image_reader("nrrd", "a.nrrd"),
    image_reader("nrrd compressed", "a.nrrd", compressed=True),
    Reader("seg.nrrd", write_slicer, read_segments),
    Reader("dicom seg", write_dicom, read_segments),
    surface_reader("ply", write_trimesh),
    surface_reader("stl", write_trimesh),
    Reader("ply of text", lambda folder: write_ascii(folder, "a.ply"), read_surface),
    Reader("stl of text", lambda folder: write_ascii(folder, "a.stl"), read_surface),
    surface_reader("obj", write_trimesh),
    surface_reader("off", write_trimesh),
    surface_reader("vtk", write_surface),
    surface_reader("vtp", write_surface),
    surface_reader("vtu", write_surface),
    Reader("gifti", write_gifti, read_surface),
    Reader("freesurfer", write_freesurfer, read_surface),
    Reader("ply strips", lambda folder: write_strips(folder, True), read_surface),
    Reader("ply strips text", lambda folder: write_strips(folder, False), read_surface),
    Reader("matching off", write_matching, read_matching),
    Reader("vts", write_vts, read_matching),
    Reader("study yaml", write_study, read_study),
    Reader("covariates csv", lambda folder: write_covariates(folder, "a.csv"), read_covariates),
    Reader("covariates tsv", lambda folder: write_covariates(folder, "a.tsv"), read_covariates),
    Reader("statismo h5", write_statismo, read_statismo),
    Reader("statismo h5.json", write_h5_json, read_statismo),
    Reader("markups", write_markups, read_markups),
    Reader("fcsv", write_fcsv, read_markups),
    Reader("covariates xlsx", write_workbook, read_covariates),
)

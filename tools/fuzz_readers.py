"""What `fuzz.py` breaks: every reader of files from outside, with a good file to start from."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import SimpleITK as sitk


@dataclass(frozen=True)
class Reader:
    """`write(folder)` makes a good file and returns the one to damage; `read(path)` reads it.

    inner  what is damaged instead of the file's own bytes: (unpack, pack), for compressed files
           whose checksum would otherwise refuse nearly every input at once.
    """

    name: str
    write: Callable[[Path], Path]
    read: Callable[[Path], object]
    inner: tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]] | None = None


def write_image(folder: Path, name: str, compressed: bool = False) -> Path:
    z, y, x = np.indices((9, 10, 11)) - 5
    image = sitk.GetImageFromArray(((x**2 + y**2 + z**2 < 14) * 3).astype(np.int16))
    image.SetSpacing((1.0, 1.5, 2.0))
    sitk.WriteImage(image, str(folder / name), compressed)
    return folder / name


def read_mask(path: Path) -> object:
    from data_prep.images import read_mask

    return read_mask(path, (3,), "case")


def image_reader(name: str, file: str, compressed: bool = False) -> Reader:
    return Reader(name, lambda folder: write_image(folder, file, compressed), read_mask)


def write_surface(folder: Path, name: str) -> Path:
    import pyvista

    pyvista.Sphere(theta_resolution=6, phi_resolution=6).save(folder / name)
    return folder / name


def write_trimesh(folder: Path, name: str) -> Path:
    import trimesh

    trimesh.creation.icosphere(subdivisions=1).export(folder / name)
    return folder / name


def read_surface(path: Path) -> object:
    from data_prep.surface_files import read_mesh

    return read_mesh(path)


def surface_reader(name: str, write: Callable[[Path, str], Path]) -> Reader:
    file = f"a.{name.split()[0]}"
    return Reader(f"surface {name}", lambda folder: write(folder, file), read_surface)


def write_matching(folder: Path) -> Path:
    from data_prep.matching_folder import write_matching_folder
    from ssm_pipeline.records import Mesh

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    write_matching_folder(folder, [Mesh(corners, faces, "a")], [np.arange(4)])
    return folder / "off" / "a.off"


def read_matching(path: Path) -> object:
    from data_prep.matching_folder import read_matching_folder

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


def write_matcher(folder: Path) -> Path:
    from ssm_pipeline.training.matcher import Matcher, save_matcher
    from ssm_pipeline.training.networks import Networks
    from ssm_pipeline.training.settings import TrainingSettings

    small = {"channels": 8, "width": 8, "blocks": 1, "descriptors": 8}
    settings = TrainingSettings.model_validate(
        {"matching": small, "interpolation": {"width": 8, "blocks": 1}}
    )
    save_matcher(Matcher(Networks.new(settings, 0), settings, 0, ("a", "b")), folder / "m.pt")
    return folder / "m.pt"


def read_matcher(path: Path) -> object:
    from ssm_pipeline.training.matcher import load_matcher

    return load_matcher(path)


def write_checkpoint(folder: Path) -> Path:
    import torch

    from ssm_pipeline.training.checkpoint import Checkpoint, save_checkpoint
    from ssm_pipeline.training.matcher import load_tensors

    weights = load_tensors(write_matcher(folder))["networks"]
    adam = torch.optim.Adam([torch.nn.Parameter(torch.zeros(3))]).state_dict()
    save_checkpoint(Checkpoint(2, weights, adam, [{"total": 1.0}]), folder / "c.pt")
    return folder / "c.pt"


def read_checkpoint(path: Path) -> object:
    from ssm_pipeline.training.checkpoint import load_checkpoint

    return load_checkpoint(path)


def write_mesh(folder: Path) -> Path:
    from ssm_pipeline import storage
    from ssm_pipeline.records import Mesh

    storage.save(Mesh(np.eye(3), np.array([[0, 1, 2]]), "a"), folder / "mesh.npz")
    return folder / "mesh.npz"


def read_mesh_record(path: Path) -> object:
    from ssm_pipeline import storage
    from ssm_pipeline.records import Mesh

    return storage.load(Mesh, path)


def write_markups(folder: Path) -> Path:
    points = [{"label": "apex", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"}]
    markups = [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": points}]
    path = folder / "points.mrk.json"
    path.write_text(json.dumps({"markups": markups}))
    return path


def read_markups(path: Path) -> object:
    from ssm_pipeline.stages.landmark_file import read_landmarks

    return read_landmarks(path)


def write_stage_record(folder: Path) -> Path:
    from ssm_pipeline.engine.stage import StageRecord

    StageRecord(
        stage="meshing",
        key="5f",
        settings={"faces": 100},
        seed=0,
        inputs={"data": "7a"},
        versions={"numpy": "2"},
        finished_at="2026-01-01T00:00:00+00:00",
        seconds=1.5,
        peak_memory_mb=100.0,
        cases_in=["a", "b"],
        cases_out=["a"],
        dropped=[{"case_id": "b", "stage": "meshing", "reason": "too small"}],
        case_keys={"a": "99"},
    ).write(folder)
    return folder / "stage.json"


def read_stage_record(path: Path) -> object:
    from ssm_pipeline.engine.stage import StageRecord

    return StageRecord.read(path.parent)


GZIP = (gzip.decompress, gzip.compress)
READERS = (
    image_reader("nii", "a.nii"),
    image_reader("nii.gz", "a.nii.gz"),
    Reader("nii in gz", lambda folder: write_image(folder, "a.nii.gz"), read_mask, GZIP),
    image_reader("mha", "a.mha"),
    image_reader("mha compressed", "a.mha", compressed=True),
    image_reader("mhd", "a.mhd"),
    image_reader("nrrd", "a.nrrd"),
    image_reader("nrrd compressed", "a.nrrd", compressed=True),
    surface_reader("ply", write_trimesh),
    surface_reader("stl", write_trimesh),
    surface_reader("obj", write_trimesh),
    surface_reader("off", write_trimesh),
    surface_reader("vtk", write_surface),
    surface_reader("vtp", write_surface),
    Reader("off", write_matching, read_matching),
    Reader("vts", write_vts, read_matching),
    Reader("study yaml", write_study, read_study),
    Reader("matcher.pt", write_matcher, read_matcher),
    Reader("checkpoint.pt", write_checkpoint, read_checkpoint),
    Reader("record npz", write_mesh, read_mesh_record),
    Reader("markups", write_markups, read_markups),
    Reader("stage.json", write_stage_record, read_stage_record),
)

"""The ShapeWorks project, read with json and NumPy as its own reader would."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from posed_spheres import Spheres

from ssm_pipeline.export.shapeworks import write_project


def test_alignment_takes_local_particles_to_world_particles(
    spheres: Spheres, tmp_path: Path
) -> None:
    path = tmp_path / "study" / "model.swproj"
    written = write_project(spheres.shapes, spheres.frames, spheres.meshes, path)
    project = json.loads(path.read_text(encoding="utf-8"))
    assert [row["name"] for row in project["data"]] == list(spheres.shapes.case_ids)
    named = {path}
    for index, row in enumerate(project["data"]):
        assert all(isinstance(value, str) for value in row.values())  # a map of strings to it
        local = np.loadtxt(path.parent / row["local_particles_1"])
        world = np.loadtxt(path.parent / row["world_particles_1"])
        np.testing.assert_allclose(local, spheres.shapes.vertices[index], atol=1e-6)
        np.testing.assert_allclose(world, spheres.aligned.vertices[index], atol=1e-6)
        alignment, procrustes = (
            np.array(row[key].split(), dtype=float).reshape(4, 4)
            for key in ("alignment_1", "procrustes_1")
        )
        moved = np.column_stack([local, np.ones(len(local))]) @ (procrustes @ alignment).T
        np.testing.assert_allclose(moved[:, :3], world, atol=1e-6)  # nine digits in the files
        assert not np.allclose(np.linalg.det(alignment), 1, atol=1e-4)  # a size was removed
        named |= {path.parent / row[key] for key in row if key.endswith("_particles_1")}
        named |= {path.parent / row["shape_1"], path.parent / row["groomed_1"]}
    assert named == set(written)


def test_surfaces_are_the_cases_own(spheres: Spheres, tmp_path: Path) -> None:
    write_project(spheres.shapes, spheres.frames, spheres.meshes, tmp_path / "model.swproj")
    for mesh in spheres.meshes:
        surface = trimesh.load_mesh(tmp_path / "surfaces" / f"{mesh.case_id}.ply", process=False)
        np.testing.assert_allclose(surface.vertices, mesh.vertices, atol=5e-5)  # float32
        np.testing.assert_array_equal(surface.faces, mesh.faces)

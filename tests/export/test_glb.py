"""The .glb is read back by pygltflib and trimesh, neither of which wrote it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh

from ssm_pipeline.export.glb import glb_bytes, write_glb
from ssm_pipeline.records import CorrespondedShapes
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model


@pytest.fixture(scope="module")
def model() -> ShapeModel:
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    generator = np.random.default_rng(0)
    stretch = 1 + 0.1 * generator.standard_normal((6, 1, 3))
    shapes = np.asarray(sphere.vertices) * stretch
    ids = tuple(f"case {n}" for n in range(6))
    return pca_model(CorrespondedShapes(shapes, np.asarray(sphere.faces), ids, ids[0]))


def read(gltf: pygltflib.GLTF2, accessor_index: int) -> np.ndarray:
    accessor = gltf.accessors[accessor_index]
    view = gltf.bufferViews[accessor.bufferView]
    kind = {pygltflib.FLOAT: "<f4", pygltflib.UNSIGNED_INT: "<u4"}[accessor.componentType]
    data = gltf.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    values = np.frombuffer(data, kind)
    return values.reshape(-1, 3) if accessor.type == "VEC3" else values


def test_targets_are_the_modes_at_one_standard_deviation(model: ShapeModel, tmp_path: Path) -> None:
    write_glb(model, tmp_path / "model.glb")
    gltf = pygltflib.GLTF2().load(str(tmp_path / "model.glb"))
    mesh = gltf.meshes[0]
    primitive = mesh.primitives[0]
    mean = read(gltf, primitive.attributes.POSITION)
    np.testing.assert_allclose(mean, model.mean, atol=1e-4)  # float32 at 100 mm: 4e-6
    np.testing.assert_array_equal(read(gltf, primitive.indices).reshape(-1, 3), model.faces)
    assert len(primitive.targets) == model.mode_count == len(mesh.extras["targetNames"])
    weights = np.array([1.5, -2.0] + [0.0] * (model.mode_count - 2))
    morphed = mean + sum(
        w * read(gltf, target["POSITION"])
        for w, target in zip(weights, primitive.targets, strict=True)
    )
    np.testing.assert_allclose(morphed, model.reconstruct(weights), atol=1e-4)
    for index in (primitive.attributes.POSITION, *(t["POSITION"] for t in primitive.targets)):
        np.testing.assert_allclose(gltf.accessors[index].min, read(gltf, index).min(axis=0))
        np.testing.assert_allclose(gltf.accessors[index].max, read(gltf, index).max(axis=0))


def test_other_programs_see_the_organ_upright_in_metres(model: ShapeModel, tmp_path: Path) -> None:
    mean = model.mean.copy()
    mean[0] += (0, 0, 25.0)  # a bump to the head end
    model = dataclasses.replace(model, mean=mean)
    write_glb(model, tmp_path / "model.glb")
    scene = trimesh.load_scene(tmp_path / "model.glb")
    loaded = scene.to_mesh()
    # (left, posterior, superior) mm becomes (left, up, front) m.
    expected = model.mean[:, [0, 2, 1]] * (1e-3, 1e-3, -1e-3)
    np.testing.assert_allclose(
        np.sort(loaded.bounds, axis=0), [expected.min(axis=0), expected.max(axis=0)], atol=1e-6
    )
    inside = trimesh.Trimesh(model.mean, model.faces).volume
    assert loaded.volume == pytest.approx(inside * 1e-9, rel=1e-5)  # and not inside out


def test_as_many_modes_as_asked(model: ShapeModel) -> None:
    gltf = pygltflib.GLTF2.load_from_bytes(glb_bytes(model, 2))
    assert len(gltf.meshes[0].primitives[0].targets) == 2
    with pytest.raises(ValueError, match="99 modes requested"):
        glb_bytes(model, 99)

"""`workflow export` on a finished run: files listed, ids or pseudonyms, and never both."""

from __future__ import annotations

import inspect
import json
import shutil
import stat
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from command_line import Workflow

from ssm_pipeline import load_run
from ssm_pipeline.cli.results import export
from ssm_pipeline.commands.export_run import FORMATS
from ssm_pipeline.commands.pseudonyms import pseudonyms_of
from ssm_pipeline.geometry.surface import volume


@pytest.fixture
def run_copy(tiny_run: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    return copy


def test_every_format_is_written_and_listed(workflow: Workflow, run_copy: Path) -> None:
    said = workflow("export", "luna16")
    assert said.code == 0, said.stderr
    listed = {Path(line).resolve() for line in said.stdout.splitlines()}
    folder = run_copy / "export"
    assert listed == {path for path in folder.rglob("*") if path.is_file()}
    files = {path.relative_to(folder).as_posix() for path in listed}
    assert {"model.npz", "scores.csv", "modes.csv", "model.glb", "model.vtp"} <= files
    assert {"model.h5", "meshes/mean.ply", "shapeworks/model.swproj", "export.json"} <= files
    about = json.loads((folder / "export.json").read_text())
    assert (about["synthetic"], about["space"], about["unit"]) == (False, "LPS", "mm")
    assert (about["cases"], about["modes"]) == (4, 3)


def test_the_template_lies_on_its_own_scan(
    workflow: Workflow, run_copy: Path, tmp_path: Path
) -> None:
    said = workflow("export", "luna16", "--format", "ply", "--to", "out")
    assert said.code == 0, said.stderr
    run = load_run(run_copy)
    template = trimesh.load_mesh(tmp_path / "out/meshes/template.ply", process=False)
    own = run.shapes.vertices[run.cases.index(run.template_id)]
    np.testing.assert_allclose(template.vertices, own, atol=1e-5)  # float32 at 40 mm
    assert not (run_copy / "export").exists()
    assert not list((tmp_path / "out").glob("*.npz"))


def test_particles_and_pictures_are_of_one_case(workflow: Workflow, run_copy: Path) -> None:
    assert workflow("export", "luna16", "--format", "shapeworks").code == 0
    run, folder = load_run(run_copy), run_copy / "export" / "shapeworks"
    for row in json.loads((folder / "model.swproj").read_text())["data"]:
        surface = trimesh.load_mesh(folder / row["groomed_1"], process=False)
        np.testing.assert_allclose(surface.vertices, run.mesh(row["name"]).vertices, atol=1e-5)
        particles = np.loadtxt(folder / row["local_particles_1"])
        _, distances, _ = trimesh.proximity.closest_point_naive(surface, particles[::10])
        assert distances.max() < 1e-4  # mm


def test_no_file_of_a_pseudonymised_export_names_a_case(workflow: Workflow, run_copy: Path) -> None:
    said = workflow("export", "luna16", "--pseudonymise")
    assert said.code == 0, said.stderr
    folder, cases = run_copy / "export-pseudonymised", load_run(run_copy).cases
    for path in folder.rglob("*"):
        assert not any(case in str(path.relative_to(folder)) for case in cases), path
        if path.is_file() and path.suffix != ".npz":  # compressed: read below
            assert not any(case.encode() in path.read_bytes() for case in cases), path
    with np.load(folder / "model.npz") as file:
        assert list(file["case_ids"]) == ["case_001", "case_002", "case_003", "case_004"]
    scores = pd.read_csv(folder / "scores.csv").set_index("case_id")
    key = pd.read_csv(run_copy / "pseudonyms.csv")
    assert sorted(key["case_id"]) == sorted(cases)
    for row in key.itertuples():  # the key leads back to the right case
        own = load_run(run_copy).model.scores[cases.index(row.case_id)]
        np.testing.assert_allclose(scores.loc[row.pseudonym], own)


def test_measurements_under_pseudonyms_are_of_the_right_case(
    workflow: Workflow, run_copy: Path
) -> None:
    run = load_run(run_copy)
    numbers = (3, 1, 4, 2)  # another order than that of the run
    names = {case: f"case_{n:03d}" for case, n in zip(run.cases, numbers, strict=True)}
    key = pd.DataFrame({"case_id": list(names), "pseudonym": list(names.values())})
    key.to_csv(run_copy / "pseudonyms.csv", index=False)
    words = ("--pseudonymise", "--format", "csv,shapeworks")
    said = workflow("export", "luna16", *words)
    assert said.code == 0, said.stderr
    folder = run_copy / "export-pseudonymised"
    table = pd.read_csv(folder / "measurements.csv")
    assert list(table["shape"])[: len(names)] == sorted(names.values())
    volumes = table.set_index("shape")["volume_ml"]
    for case, name in names.items():
        mesh = run.mesh(case)
        expected = volume(mesh.vertices, mesh.faces) / 1000
        assert volumes[name] == pytest.approx(expected, rel=1e-6)
    for row in json.loads((folder / "shapeworks" / "model.swproj").read_text())["data"]:
        surface = trimesh.load_mesh(folder / "shapeworks" / row["groomed_1"], process=False)
        case = next(case for case, name in names.items() if name == row["name"])
        np.testing.assert_allclose(surface.vertices, run.mesh(case).vertices, atol=1e-5)
        particles = np.loadtxt(folder / "shapeworks" / row["local_particles_1"])
        np.testing.assert_allclose(particles, run.shapes.vertices[run.cases.index(case)], atol=1e-4)


def test_ids_and_pseudonyms_never_share_a_folder(workflow: Workflow, run_copy: Path) -> None:
    assert workflow("export", "luna16", "--format", "csv", "--to", "out").code == 0
    mixed = workflow("export", "luna16", "--format", "npz", "--to", "out", "--pseudonymise")
    assert mixed.code == 1
    assert "out holds the cases' own ids" in mixed.stderr
    assert not Path("out/model.npz").exists()
    assert workflow("export", "luna16", "--to", "out", "--format", "npz").code == 0  # adds to it
    assert workflow("export", "luna16", "--to", "hidden", "--pseudonymise").code == 0
    mixed = workflow("export", "luna16", "--to", "hidden")
    assert mixed.code == 1
    assert "hidden holds pseudonyms" in mixed.stderr
    key_inside = workflow("export", "luna16", "--to", "runs", "--pseudonymise")
    assert key_inside.code == 1
    assert "would contain the key" in key_inside.stderr


def test_pseudonyms_stay_when_the_study_grows(tmp_path: Path) -> None:
    first = pseudonyms_of(["b", "007"], tmp_path)
    assert set(first.values()) == {"case_001", "case_002"}
    second = pseudonyms_of(["a", "007", "NA"], tmp_path)
    assert second["007"] == first["007"]
    assert {second["a"], second["NA"]} == {"case_003", "case_004"}
    assert pseudonyms_of(["b"], tmp_path) == {"b": first["b"]}


def test_pseudonyms_are_not_numbered_as_the_ids_are_sorted(tmp_path: Path) -> None:
    ids = [f"visit-{year}" for year in range(1980, 2020)]
    names = list(pseudonyms_of(ids, tmp_path).values())
    assert sorted(names) != names  # one order of 40! is the ids' own
    # Drawn by the system, not by a seed: another study's are other ones.
    assert list(pseudonyms_of(ids, tmp_path / "other").values()) != names
    assert stat.S_IMODE((tmp_path / "pseudonyms.csv").stat().st_mode) == 0o600


def test_unknown_formats_and_runs_are_refused(workflow: Workflow, run_copy: Path) -> None:
    said = workflow("export", "luna16", "--format", "npz,stl")
    assert said.code == 1
    assert f"there is no export format stl. Known: {', '.join(FORMATS)}." in said.stderr
    assert not (run_copy / "export").exists()
    said = workflow("export", "hippocampus")
    assert said.code == 1
    assert "holds no run" in said.stderr


def test_all_formats_are_the_default() -> None:
    assert inspect.signature(export).parameters["formats"].default == ",".join(FORMATS)

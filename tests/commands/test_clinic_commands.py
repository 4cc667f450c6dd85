"""`workflow import`, `fit`, `compare`, `transfer`, `export`, on a made-up model of twelve cases."""

from __future__ import annotations

import dataclasses
import gzip
import json
import runpy
import shutil
import stat
import sys
import types
import zipfile
from pathlib import Path

import h5py
import igl
import numpy as np
import pandas as pd
import pytest
import pyvista
import SimpleITK as sitk
import trimesh
from command_line import Workflow
from seg_files import write_dicom_seg, write_seg_nrrd
from tiny_study import write_balls

from ssm_pipeline import load_run
from ssm_pipeline.cohort_check.copies import copies_table
from ssm_pipeline.commands.import_model import import_model
from ssm_pipeline.data_prep.formats.landmarks import landmarks_from_markups
from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.records import CorrespondedShapes, Mask
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model

IDS = tuple(f"patient-{index:02d}-Miller" for index in range(12))


def cohort() -> CorrespondedShapes:
    """Twelve uneven ellipsoids of 60 mm in correspondence: three modes and some roughness."""
    ball = trimesh.creation.icosphere(2)
    generator = np.random.default_rng(2)
    unit = ball.vertices
    points = unit * [22.0, 27.0, 33.0] * (1 + 0.15 * np.sin(unit @ [[1.1], [-0.7], [1.6]] * 2))
    shapes = []
    for _ in IDS:
        stretch = 1 + 0.06 * generator.standard_normal(3)
        wave = np.sin(unit @ (2 * generator.standard_normal(3)) + 6 * generator.random())
        shapes.append(points * stretch + 0.5 * wave[:, None] * unit)
    return CorrespondedShapes(np.stack(shapes), np.asarray(ball.faces), IDS, IDS[0])


def surface_in(path: str | Path) -> pyvista.PolyData:
    surface = pyvista.read(path)
    assert isinstance(surface, pyvista.PolyData)
    return surface


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clinic")
    pca_model(align(cohort())[0]).save(folder / "organ.npz")
    return import_model(folder / "organ.npz", None, folder / "runs", (3,))


def in_an_image(run: Path, path: Path, slices: int | None = None) -> None:
    """A new case of the model as a label image, label 3, 1.5 mm; cut off after `slices` slices."""
    model = load_run(run).model
    z, y, x = np.indices((56, 48, 44))
    points = (np.stack([x - 22, y - 24, z - 28], -1) * 1.5).reshape(-1, 3)
    inside = igl.winding_number(model.reconstruct([0.7, -0.5]), model.faces, points) > 0.5
    voxels = inside.reshape(z.shape).astype(np.uint8)[:slices] * 3
    image = sitk.GetImageFromArray(voxels)
    image.SetSpacing([1.5] * 3)
    image.SetOrigin([100.0, -50.0, 700.0])
    sitk.WriteImage(image, str(path))


def test_an_imported_model_is_the_same_model_and_its_report_opens(run: Path) -> None:
    imported, shapes = load_run(run), cohort()
    model = pca_model(align(shapes)[0])
    np.testing.assert_allclose(imported.model.mean, model.mean)
    np.testing.assert_allclose(imported.shapes.vertices, model.reconstruct(model.scores))
    assert imported.cases == IDS
    assert "organ" in (run / "report" / "index.html").read_text(encoding="utf-8")


def test_patients_are_fitted_from_masks_and_surfaces(workflow: Workflow, run: Path) -> None:
    in_an_image(run, Path("whole.nii.gz"))
    in_an_image(run, Path("cut.mhd"), slices=36)
    model = load_run(run).model
    surface = trimesh.Trimesh(model.reconstruct([-1.0]) * [1, -1, -1], model.faces)
    surface.export("down.ply")
    Path("notes.txt").write_text("none")
    files = ("whole.nii.gz", "cut.mhd", "down.ply", "notes.txt")
    said = workflow("fit", str(run), *files, "--out", "fits", "--jobs", "1")
    assert said.code == 0, said.stderr
    assert "left out notes.txt: this is neither a label image" in said.stdout
    table = pd.read_csv("fits/fits.csv").set_index("case_id")
    assert list(table.index) == ["whole", "cut", "down", "notes.txt"]
    assert table.pop("left_out").drop("notes.txt").isna().all()
    table = table.drop("notes.txt")
    assert table.loc["whole", "mean_mm"] < 1.0
    assert not table.loc["whole", "flagged"]
    assert 55 < table.loc["cut", "observed_percent"] < 90
    assert table.loc["down", "flags"].startswith("turned")
    scores = pd.read_csv("fits/scores.csv")
    first = scores[(scores["case_id"] == "whole") & (scores["mode"] == 1)].iloc[0]
    assert first["low_sd"] < 0.7 < first["high_sd"]
    for case in table.index:
        mapped = pyvista.read(f"fits/{case}/reconstruction.vtp")
        assert mapped.n_points == len(model.mean)
        assert {"distance_mm", "observed", "sd_mm", "radius_90_mm"} <= set(mapped.point_data)
    # In the scan's own place: the image's middle.
    middle = pyvista.read("fits/whole/reconstruction.vtp").points.mean(axis=0)
    np.testing.assert_allclose(middle, [133.0, -14.0, 742.0], atol=3)
    assert "whole" in Path("fits/index.html").read_text(encoding="utf-8")


def test_a_patient_is_read_from_segments_by_name_and_surfaces_in_metres(
    workflow: Workflow, run: Path
) -> None:
    in_an_image(run, Path("whole.nii.gz"))
    image = sitk.ReadImage("whole.nii.gz")
    mask = Mask(
        sitk.GetArrayFromImage(image) == 3,
        np.array(image.GetSpacing()),
        np.array(image.GetOrigin()),
        np.eye(3),
        "whole",
    )
    write_dicom_seg(Path("seg.dcm"), mask, {"organ": mask.voxels})
    write_seg_nrrd(Path("slicer.seg.nrrd"), mask, {"organ": mask.voxels})
    words = ("seg.dcm", "slicer.seg.nrrd", "whole.nii.gz", "--out", "fits", "--jobs", "1")
    said = workflow("fit", str(run), *words, "--segment", "organ")
    assert said.code == 0, said.stderr
    assert "left out whole: this file has no named segments" in said.stdout
    table = pd.read_csv("fits/fits.csv").set_index("case_id")
    # The last digits of the headers differ, and from those on reduction chooses other triangles.
    assert table.loc["seg", "mean_mm"] == pytest.approx(table.loc["slicer", "mean_mm"], abs=0.05)
    unnamed = workflow("fit", str(run), "seg.dcm", "--out", "other")
    assert "left out seg: this is a DICOM SEG. Name its segment" in unnamed.stdout
    model = load_run(run).model
    trimesh.Trimesh(model.reconstruct([0.5]) / 1000, model.faces).export("metres.stl")
    unsaid = workflow("fit", str(run), "metres.stl", "--out", "other")
    assert "metres? Pass --unit m, or mm if it is right as it is" in unsaid.stdout
    assert "data.unit" not in unsaid.stdout
    said = workflow("fit", str(run), "metres.stl", "--unit", "m", "--out", "other", "--jobs", "1")
    assert said.code == 0, said.stderr
    assert pd.read_csv("other/fits.csv")["mean_mm"][0] < 1.0


def test_unusable_files_are_listed_and_a_second_call_into_the_folder_is_refused(
    workflow: Workflow, run: Path
) -> None:
    model = load_run(run).model
    for number in range(2):
        path = Path(f"new/p{number}/seg/organ.ply")
        path.parent.mkdir(parents=True)
        trimesh.Trimesh(model.reconstruct([0.3 * number]), model.faces).export(path)
    for name in ("empty", "cut", "text"):
        path = Path(f"new/{name}/seg/organ.ply")
        path.parent.mkdir(parents=True)
        path.write_bytes({"empty": b"", "cut": b"ply\nformat", "text": b"none"}[name])
    Path("new/gone/seg").mkdir(parents=True)
    Path("new/gone/seg/organ.ply").symlink_to("/nowhere/organ.ply")
    said = workflow("fit", str(run), "new", "--jobs", "1")
    assert said.code == 0, said.stderr
    assert "4 of 6 patients left out" in said.stdout
    table = pd.read_csv("fits/fits.csv").set_index("case_id")
    assert list(table.index[:2]) == ["p0", "p1"]
    reasons = table["left_out"].dropna()
    assert set(reasons.index) == {"empty", "cut", "text", "gone"}
    assert "link to /nowhere/organ.ply, which does not exist" in reasons["gone"]
    page = Path("fits/index.html").read_text(encoding="utf-8")
    assert "Patients that could not be fitted (4)" in page
    assert all(f"<td>{name}</td>" in page for name in reasons.index)
    again = workflow("fit", str(run), "new/p0/seg/organ.ply", "--jobs", "1")
    assert again.code == 1
    assert "fits holds the results of an earlier fit" in again.stderr
    assert "--out" in again.stderr


def test_by_matcher_the_template_is_laid_on_the_patient(
    workflow: Workflow, tiny_run: Path, tmp_path: Path
) -> None:
    run_copy = tmp_path / "runs" / "balls"
    shutil.copytree(tiny_run, run_copy)
    masks = write_balls(tmp_path / "new", 5)
    files = [str(masks / f"ball_{number}.nii.gz") for number in (4, 2)]  # 2: a case of the model
    words = ("fit", str(run_copy), *files, "--by", "matcher", "--jobs", "1")
    said = workflow(*words)
    assert said.code == 0, said.stderr
    assert "has 4 cases of 4 patients, but 6 or more are needed to judge" in said.stdout
    assert "Compared with 20 shapes drawn from the model" in Path("fits/index.html").read_text(
        "utf-8"
    )
    table = pd.read_csv("fits/fits.csv")
    assert list(table["case_id"]) == ["ball_4", "ball_2"]
    assert set(table["by"]) == {"matcher"}
    # Half a voxel is 1 mm, and three modes of four balls are not the fifth.
    assert table["mean_mm"].max() < 2.5


def test_what_cannot_be_fitted_is_refused(workflow: Workflow, run: Path) -> None:
    Path("a.txt").write_text("none")
    for words, message in (
        (("a.txt",), "no patient could be fitted"),
        (("a.ply", "x/a.stl", "b.ply"), "two files are called a"),
        (("z.seg.nrrd", "z.nrrd"), "two files are called z"),
        (("1.3.6.1.nii.gz", "1.3.6.2.nii.gz"), "no patient could be fitted"),  # and not doubled
        (("a.ply", "--by", "magic"), "--by magic: model or matcher is needed"),
    ):
        said = workflow("fit", str(run), *words)
        assert said.code == 1
        assert message in said.stderr


def test_shapes_are_compared_with_covariates(workflow: Workflow, run: Path) -> None:
    scores = load_run(run).model.scores
    table = pd.DataFrame(
        {
            "participant_id": IDS,
            "group": np.where(scores[:, 0] > np.median(scores[:, 0]), "large", "small"),
            "age": np.linspace(40, 70, 12),
        }
    )
    table.sample(frac=1, random_state=0).to_csv("people.tsv", sep="\t", index=False)
    words = ("compare", str(run), "--covariates", "people.tsv", "--permutations", "499")
    said = workflow(*words, "--formula", "~ group", "--out", "out")
    assert said.code == 0, said.stderr
    tests = pd.read_csv("out/tests.csv")
    assert tests["procrustes_p"][0] < 0.05
    assert 0 < tests["hotelling_p"][0] < 0.2
    with np.load("out/vertex_maps.npz") as maps:
        assert maps["displacement_mm_0"].shape == load_run(run).model.mean.shape
    about = json.loads(Path("out/compare.json").read_text())
    assert about["maps"] == ["group: small against large"]
    assert "~ group" in Path("out/index.html").read_text(encoding="utf-8")
    assert "tab Compare" not in said.stdout  # it was sent elsewhere: the run is left as it was
    refused = workflow(*words, "--formula", "~ hight")
    assert refused.code == 1
    assert "names hight, and the table has group, age" in refused.stderr
    table.iloc[1:].to_csv("people.tsv", sep="\t", index=False)
    refused = workflow(*words, "--formula", "~ age")
    assert f"1 in the model but not in the table: {IDS[0]}" in refused.stderr


def test_a_comparison_of_the_runs_own_is_a_tab_of_its_report(
    workflow: Workflow, run: Path, tmp_path: Path
) -> None:
    own = tmp_path / "runs" / "organ"
    shutil.copytree(run, own)
    pd.DataFrame({"case_id": IDS, "age": np.linspace(40, 70, 12)}).to_csv("a.csv", index=False)
    words = ("--covariates", "a.csv", "--permutations", "99")
    said = workflow("compare", str(own), *words, "--formula", "~ age")
    assert said.code == 0, said.stderr
    assert f"tab Compare: {own / 'report' / 'index.html'}" in said.stdout
    page = (own / "report" / "index.html").read_text(encoding="utf-8")
    assert 'id="tab-compare"' in page
    assert workflow("verify", str(own)).code == 0  # the report is as it was written
    (read,) = load_run(own).comparisons
    table = pd.read_csv(own / "compare" / "age" / "tests.csv")
    pd.testing.assert_frame_equal(read.tests, table)
    np.testing.assert_allclose(read.design.matrix[:, 1], np.linspace(40, 70, 12))
    assert read.maps[0].displacement_mm.shape == load_run(own).model.mean.shape
    other = workflow("compare", str(own), *words, "--formula", "~ age:age")
    assert other.code == 0, other.stderr
    assert len(load_run(own).comparisons) == 2  # each formula has its own
    (second,) = (own / "compare").glob("age-*")
    shutil.rmtree(second)
    # Of another model, it is not shown as this one's; damaged, it is named.
    about = json.loads((own / "compare" / "age" / "compare.json").read_text())
    of_another = json.dumps(about | {"model_key": "another"})
    (own / "compare" / "age" / "compare.json").write_text(of_another)
    assert load_run(own).comparisons == ()
    (own / "compare" / "age" / "compare.json").write_text(json.dumps(about))
    (own / "compare" / "age" / "power.csv").unlink()
    again = workflow("compare", str(own), *words, "--formula", "~ age + 1")
    assert "compare/age can't be shown: power.csv is missing" in again.stderr


def test_several_cases_of_a_patient_are_not_compared(
    workflow: Workflow, run: Path, tmp_path: Path
) -> None:
    own = tmp_path / "runs" / "sides"
    shutil.copytree(run, own)
    assert set(load_run(own).patients.values()) == set(IDS)  # an imported model knows no patients
    sides = pd.DataFrame({"case_id": IDS, "patient": [f"p{number // 2}" for number in range(12)]})
    (own / "data").mkdir()
    sides.to_csv(own / "data" / "cohort.csv", index=False)
    pd.DataFrame({"case_id": IDS, "age": np.linspace(40, 70, 12)}).to_csv("a.csv", index=False)
    refused = workflow("compare", str(own), "--covariates", "a.csv", "--formula", "~ age")
    assert refused.code == 1
    assert "6 patients have several cases" in refused.stderr
    assert "p0, p1, p2 …" in refused.stderr
    assert "set data.cases to one case of each" in refused.stderr
    assert "data.side" not in refused.stderr  # masks have no such setting
    # Ids that look like numbers stay text: 01 and 1 are two patients.
    sides["patient"] = [f"{number // 2:02d}" for number in range(10)] + ["1", "2"]
    sides.to_csv(own / "data" / "cohort.csv", index=False)
    assert list(load_run(own).patients.values())[-4:] == ["04", "04", "1", "2"]
    refused = workflow("compare", str(own), "--covariates", "a.csv", "--formula", "~ age")
    assert "5 patients have several cases" in refused.stderr
    assert "00, 01, 02 …" in refused.stderr


def test_copies_are_one_patient_and_are_not_compared(
    workflow: Workflow, run: Path, tmp_path: Path
) -> None:
    own = tmp_path / "runs" / "copies"
    shutil.copytree(run, own)
    copies = copies_table([(IDS[2], IDS[7], "the same")])
    (own / "cohort_check").mkdir(exist_ok=True)
    copies.to_csv(own / "cohort_check" / "copies.csv", index=False)
    patients = load_run(own).patients
    assert patients[IDS[7]] == patients[IDS[2]] == IDS[2]
    assert len(set(patients.values())) == 11
    pd.DataFrame({"case_id": IDS, "age": np.linspace(40, 70, 12)}).to_csv("a.csv", index=False)
    refused = workflow("compare", str(own), "--covariates", "a.csv", "--formula", "~ age")
    assert refused.code == 1
    assert "holds 1 copy among its 12 cases" in refused.stderr
    assert f'"{IDS[7]}": "copy of {IDS[2]}"' in refused.stderr


def test_landmarks_and_labels_come_to_every_case_and_patient(workflow: Workflow, run: Path) -> None:
    held = load_run(run)
    template, faces = held.shapes.template, held.shapes.faces
    top = int(template[:, 2].argmax())
    ras = (template[top] * [-1, -1, 1]).tolist()
    point = {"label": "apex", "position": ras, "positionStatus": "defined"}
    content = {"markups": [{"coordinateSystem": "RAS", "controlPoints": [point]}]}
    Path("template.mrk.json").write_text(json.dumps(content))
    upper = np.flatnonzero(template[:, 2] > 0)
    pd.DataFrame({"vertex": upper, "label": "upper"}).to_csv("labels.csv", index=False)
    new_patient = held.model.reconstruct([1.0]) + 40
    trimesh.Trimesh(new_patient, faces).export("new.stl")
    seen = (new_patient[faces, 2] < new_patient[top, 2] - 20).all(axis=1)  # the apex is cut off
    trimesh.Trimesh(new_patient, faces[seen]).export("cut.stl")
    assert workflow("fit", str(run), "new.stl", "cut.stl", "--out", "fits", "--jobs", "1").code == 0
    words = ("--landmarks", "template.mrk.json", "--labels", "labels.csv", "--fits", "fits")
    said = workflow("transfer", str(run), *words, "--out", "carried")
    assert said.code == 0, said.stderr
    for case, points in zip(held.cases, held.shapes.vertices, strict=True):
        file = Path("carried") / case / "landmarks.mrk.json"
        carried = landmarks_from_markups(json.loads(file.read_text()))
        assert carried.names == ("apex",)
        np.testing.assert_allclose(carried.positions[0], points[top], atol=1e-3)
        labelled = surface_in(file.with_name("labels.vtp"))
        np.testing.assert_array_equal(np.flatnonzero(labelled["label"]), upper)
    table = pd.read_csv("carried/landmarks.csv").set_index("case_id")
    seen_by = {**dict.fromkeys(held.cases, True), "new": True, "cut": False}
    assert table["observed"].to_dict() == seen_by
    assert table.loc[list(held.cases), "radius_mm"].isna().all()
    assert 0 < table.loc["new", "radius_mm"] < table.loc["cut", "radius_mm"]
    surface = surface_in("fits/cut/reconstruction.vtp")
    assert table.loc["cut", "radius_mm"] == pytest.approx(surface["radius_90_mm"][top], rel=1e-4)
    (marked,) = json.loads(Path("carried/cut/landmarks.mrk.json").read_text())["markups"]
    assert "not observed" in marked["controlPoints"][0]["description"]
    labelled = surface_in("carried/cut/labels.vtp")
    np.testing.assert_array_equal(labelled["observed"], surface["observed"])
    assert list(labelled.field_data["SPACE"]) == list(surface.field_data["SPACE"]) == ["LPS"]
    new = table.loc["new"]
    expected = held.model.reconstruct([1.0])[top] + 40
    np.testing.assert_allclose(
        new[["left_mm", "posterior_mm", "superior_mm"]].astype(float), expected, atol=2.0
    )
    assert workflow("transfer", str(run)).code == 1
    Path("labels.csv").write_text("vertex,label\n99999,a\n")
    said = workflow("transfer", str(run), "--labels", "labels.csv")
    assert "names vertices 99999 to 99999; 0 to 161 are the template's" in said.stderr


def test_an_export_explains_itself(
    workflow: Workflow, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = workflow("export", "organ", "--runs", str(run.parent), "--to", "out")
    assert said.code == 0, said.stderr
    readme = Path("out/README.md").read_text()
    for path in Path("out").iterdir():
        if path.name != "README.md":
            assert f"`{path.name}{'/' * path.is_dir()}`" in readme, path
    description = json.loads(Path("out/dataset_description.json").read_text())
    assert {"Name", "BIDSVersion", "DatasetType", "GeneratedBy"} <= set(description)
    assert "12 cases" in Path("out/MODEL_CARD.md").read_text()
    table = pd.read_csv("out/measurements.csv").set_index("shape")
    mesh = load_run(run).mesh(IDS[3])
    assert table.loc[IDS[3], "volume_ml"] == pytest.approx(volume(mesh.vertices, mesh.faces) / 1e3)
    assert table.loc[IDS[3], "area_cm2"] == pytest.approx(area(mesh.vertices, mesh.faces) / 100)
    plus, minus = table.loc["mode_1_plus_2sd"], table.loc["mode_1_minus_2sd"]
    assert plus["corresponded_volume_ml"] != pytest.approx(
        minus["corresponded_volume_ml"], rel=0.01
    )
    assert np.isnan(plus["volume_ml"])  # a shape of the model has no mesh of its own
    # On the model's triangles a case is another number, in a column of its own.
    shapes = load_run(run).shapes
    matched = shapes.vertices[shapes.case_ids.index(IDS[3])]
    expected = volume(matched, shapes.faces) / 1e3
    assert table.loc[IDS[3], "corresponded_volume_ml"] == pytest.approx(expected)
    # The script, with a Slicer that notes what it is asked for.
    asked: list[str] = []
    node = types.SimpleNamespace(
        GetDisplayNode=lambda: types.SimpleNamespace(
            SetOpacity=lambda value: None, SetVisibility=lambda value: None
        )
    )

    def load_model(path: str) -> object:
        asked.append(path)
        return node

    util = types.SimpleNamespace(
        loadModel=load_model,
        loadMarkups=asked.append,
        resetThreeDViews=lambda: None,
    )
    monkeypatch.setitem(sys.modules, "slicer", types.SimpleNamespace(util=util))
    runpy.run_path("out/load_in_slicer.py")
    assert {Path(path).name for path in asked} == {p.name for p in Path("out/meshes").iterdir()}


def all_bytes(path: Path) -> list[bytes]:
    """A file's bytes, and what is inside it where it is packed."""
    content = [path.read_bytes()]
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as packed:
            content += [packed.read(name) for name in packed.namelist()]
    if path.suffix == ".gz":
        content.append(gzip.decompress(content[0]))
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            file.visititems(
                lambda name, item: content.append(
                    name.encode()
                    + (bytes(np.asarray(item)) if isinstance(item, h5py.Dataset) else b"")
                )
            )
    return content


def test_no_byte_of_a_pseudonymised_export_tells_an_id(workflow: Workflow, run: Path) -> None:
    said = workflow("export", "organ", "--runs", str(run.parent), "--to", "out", "--pseudonymise")
    assert said.code == 0, said.stderr
    wanted = [*IDS, "Miller", "patient-", str(run.parent)]
    wanted_bytes = [w.encode(code) for w in wanted for code in ("utf-8", "utf-16-le", "utf-32-le")]
    for path in Path("out").rglob("*"):
        assert not any(word in str(path) for word in wanted), path
        for content in all_bytes(path) if path.is_file() else ():
            assert not any(word in content for word in wanted_bytes), path
    # Nor does the order of the rows: it is the pseudonyms' own.
    scores = pd.read_csv("out/scores.csv")
    assert list(scores["case_id"]) == sorted(scores["case_id"])
    key_file = run / "pseudonyms.csv"
    assert stat.S_IMODE(key_file.stat().st_mode) == 0o600
    key = pd.read_csv(key_file).set_index("pseudonym")["case_id"]
    # Whatever the order of the rows, each row is of its own case.
    measured = pd.read_csv("out/measurements.csv").set_index("shape")["volume_ml"]
    assert list(key.sort_index()) != list(IDS)
    for pseudonym, case_id in key.items():
        mesh = load_run(run).mesh(case_id)
        expected = volume(mesh.vertices, mesh.faces) / 1e3
        assert measured[pseudonym] == pytest.approx(expected, rel=1e-6)
    model = load_run(run).model
    for row in scores.set_index("case_id").itertuples():
        own = model.scores[model.case_ids.index(key[row.Index])]
        np.testing.assert_allclose(row[1:], own, atol=1e-9)


def test_a_statismo_file_of_ours_comes_back(workflow: Workflow, run: Path) -> None:
    said = workflow(
        "export", "organ", "--runs", str(run.parent), "--to", "out", "--format", "statismo"
    )
    assert said.code == 0, said.stderr
    said = workflow("import", "out/model.h5", "--name", "back")
    assert said.code == 0, said.stderr
    ours, back = load_run(run).model, load_run("runs/back").model
    assert back.case_ids == ours.case_ids
    # float32 in the file: 1e-7 of 100 mm.
    np.testing.assert_allclose(back.mean, ours.mean, atol=1e-4)
    np.testing.assert_allclose(
        back.reconstruct(back.scores), ours.reconstruct(ours.scores), atol=1e-3
    )
    again = workflow("import", "out/model.h5", "--name", "back")
    assert again.code == 1
    assert "is not empty" in again.stderr


def test_what_is_mirrored_comes_back_to_its_own_side(workflow: Workflow, run: Path) -> None:
    """Right cases are matched as mirror images; what is written lies where the scan has it."""
    model = load_run(run).model
    sides = tuple(f"p{number}_{'left' if number % 2 else 'right'}" for number in range(12))
    dataclasses.replace(model, case_ids=sides).save("sides.npz")
    assert workflow("import", "sides.npz", "--runs", "runs").code == 0
    settings = Path("runs/sides/study.yaml")
    settings.write_text(settings.read_text().replace("mirror: null", "mirror: right"))
    held = load_run("runs/sides")
    assert held.reflected == {name for name in sides if "right" in name}
    point = {"label": "tip", "position": held.shapes.template[7].tolist()}
    content = {"markups": [{"coordinateSystem": "LPS", "controlPoints": [point]}]}
    Path("tip.mrk.json").write_text(json.dumps(content))
    pd.DataFrame({"vertex": [7], "label": "tip"}).to_csv("labels.csv", index=False)
    shape = model.reconstruct([1.0]) + np.array([40.0, 0, 0])
    trimesh.Trimesh(shape * [-1, 1, 1], model.faces[:, ::-1]).export("new.stl")
    words = ("new.stl", "--mirror", "--out", "fits", "--jobs", "1")
    said = workflow("fit", "runs/sides", *words)
    assert said.code == 0, said.stderr
    for name in ("surface.ply", "reconstruction.ply", "reconstruction.vtp"):
        surface = pyvista.read(Path("fits/new") / name)
        assert surface.points[:, 0].mean() == pytest.approx(-shape[:, 0].mean(), abs=1.0)
        faces = surface.faces.reshape(-1, 4)[:, 1:]
        assert volume(np.asarray(surface.points, float), faces) > 0  # outward still
    words = ("--landmarks", "tip.mrk.json", "--labels", "labels.csv", "--fits", "fits")
    said = workflow("transfer", "runs/sides", *words, "--out", "carried")
    assert said.code == 0, said.stderr
    table = pd.read_csv("carried/landmarks.csv").set_index("case_id")["left_mm"]
    for name, vertices in zip(sides, held.shapes.vertices, strict=True):
        side = -1 if "right" in name else 1
        assert table[name] == pytest.approx(side * vertices[7, 0], abs=1e-3)
    assert table["new"] == pytest.approx(-shape[7, 0], abs=2.0)
    for name in (sides[0], sides[1], "new"):
        labelled = pyvista.read(f"carried/{name}/labels.vtp")
        faces = labelled.faces.reshape(-1, 4)[:, 1:]
        assert volume(np.asarray(labelled.points, float), faces) > 0


def test_a_model_from_elsewhere_is_taken_with_care(
    workflow: Workflow, run: Path, tmp_path: Path
) -> None:
    """Ids that are paths, triangles that look inward, a byte that changes; nothing is claimed."""
    model = load_run(run).model
    paths = tuple(f"{tmp_path}/elsewhere/liver_{number}.vtk" for number in range(12))
    other = dataclasses.replace(model, case_ids=paths, faces=model.faces[:, ::-1])
    other.save("other.npz")
    assert workflow("import", "other.npz", "--runs", "runs").code == 0
    held = load_run("runs/other")
    assert held.cases[0] == "liver_0.vtk"
    assert not (tmp_path / "elsewhere").exists()
    assert volume(held.model.mean, held.model.faces) > 0
    assert workflow("verify", "runs/other").code == 0
    said = workflow("export", "other", "--runs", "runs", "--to", "out")
    assert said.code == 0, said.stderr
    card = Path("out/MODEL_CARD.md").read_text()
    assert "the model was imported" in card
    assert "stiffness" not in card
    assert "may or may not have been removed" in card
    stored = Path("runs/other/shape_model/model.npz")
    stored.write_bytes(stored.read_bytes()[:-1] + b"x")
    assert workflow("verify", "runs/other").code == 1

"""`workflow benchmark matching` on phantoms, each with a triangulation of its own."""

from __future__ import annotations

import datetime
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import Said, Workflow

from ssm_pipeline import storage
from ssm_pipeline.data_prep.matching_sets.matching_folder import (
    read_matching_folder,
    write_matching_folder,
)
from ssm_pipeline.data_prep.matching_sets.remeshed_phantoms import remeshed_phantoms
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.smooth_phantoms import draw
from ssm_pipeline.experiments import benchmark_files, matching_benchmark
from ssm_pipeline.experiments.matching_benchmark_settings import read_preset
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import Mesh

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
TINY = (
    "spectral.eigenpairs=20",
    "training.steps=3",
    "training.matching={channels: 16, width: 16, blocks: 1, descriptors: 16}",
    "training.interpolation={width: 8, blocks: 1}",
    "adaptation={samples: 500, steps: 3, path_times: 3}",
)


@pytest.fixture(scope="module")
def lungs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four shapes in the literature's layout."""
    truth, _ = draw(PhantomSettings(cases=4, modes=3, seed=1))
    shapes = remeshed_phantoms(truth, [350, 420, 490, 560])
    folder = tmp_path_factory.mktemp("matching") / "lungs"
    write_matching_folder(folder, shapes.meshes, shapes.template_to_shape)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shared by the tests, as by a user's calls: bases and distances are computed once."""
    return tmp_path_factory.mktemp("matching-runs")


def words(lungs: Path, runs: Path, *changes: str) -> list[str]:
    settings = [word for change in (*TINY, *changes) for word in ("--set", change)]
    return ["benchmark", "matching", "--data", str(lungs), "--runs", str(runs), *settings]


def tables(said: Said) -> str:
    """What is said but for the cost and, on a slow machine, the progress."""
    passing = re.compile(r"measuring|about .* here|\d of \d|reused|changed from")
    return "\n".join(line for line in said.stdout.splitlines() if not passing.search(line))


def test_trains_on_one_part_and_tests_on_another(
    workflow: Workflow, lungs: Path, runs: Path
) -> None:
    options = ("--train", "0:3", "--test", "2:4", "--methods", "full, adaptation only")
    said = workflow(*words(lungs, runs), *options)
    assert said.code == 0, said.stderr
    folder = runs / "matching-lungs"
    assert f"tables and curves: {folder}" in said.stdout
    cost = r"about .* here: training, 3 steps of .*; full, 2 pairs of .*; adaptation only, 2 pairs"
    assert re.search(cost, said.stdout)
    assert (folder / "pck.png").read_bytes().startswith(b"\x89PNG")
    (matcher,) = folder.glob("matchers/*/matcher-*.pt")
    assert not list(folder.glob("matchers/*/checkpoint-*.pt"))
    summary = pd.read_csv(folder / "summary.csv")
    trained = "full (trained on 1 of the test shapes)"
    assert summary["method"].tolist() == [trained, "adaptation only"]
    assert (summary["shapes"].tolist(), summary["pairs"].tolist()) == ([2, 2], [2, 2])
    pairs = pd.read_csv(folder / "pairs.csv")
    assert set(pairs["x"]) == {"phantom.002", "phantom.003"}
    means = pairs.groupby("method", sort=False)["mean_geodesic_error_x100"].mean()
    assert summary["mean_geodesic_error_x100"].tolist() == pytest.approx(means.tolist())
    curves = pd.read_csv(folder / "pck.csv")
    for _, curve in curves.groupby("method"):
        assert curve["share"].is_monotonic_increasing
        assert 0 <= curve["share"].iloc[0] <= curve["share"].iloc[-1] <= 1
    assert set(curves["method"]) == set(summary["method"])

    paths = pd.read_csv(folder / "interpolation.csv")
    assert paths.groupby(["template_id", "case_id"]).size().tolist() == [3, 3]  # times, each pair
    assert paths.loc[paths["t"] == 0, "conformal_distortion"].to_numpy() == pytest.approx(2)
    assert "between the ends of interpolations: conformal distortion" in said.stdout
    curve = pd.read_csv(folder / "interpolation_curve.csv")
    assert curve["share"].is_monotonic_increasing

    # The same again reads matcher and maps; a matcher given by --checkpoint is used as it is.
    stamps = {path: path.stat().st_mtime_ns for path in (matcher, *folder.glob("maps/*/*.npy"))}
    assert len(stamps) == 1 + 2 * 2
    again = workflow(*words(lungs, runs), *options)
    assert tables(again) == tables(said)
    assert "here: training" not in again.stdout
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    longer = ("--steps", "50", "--checkpoint", str(matcher))
    given = workflow(*words(lungs, runs), *longer, *options)
    assert given.code == 0, given.stderr
    assert tables(given) == tables(said)  # 50 steps were not trained
    assert list(folder.glob("matchers/*/matcher-*.pt")) == [matcher]


def test_rows_accumulate_and_say_how_they_differ(
    workflow: Workflow, lungs: Path, tmp_path: Path
) -> None:
    call = words(lungs, tmp_path)
    assert workflow(*call, "--methods", "adaptation only", "--test", "0:2").code == 0
    other = ("--methods", "nearest point,adaptation only", "--set", "seed=1", "--test", "0:2")
    assert workflow(*call, *other).code == 0
    folder = tmp_path / "matching-lungs"
    summary = pd.read_csv(folder / "summary.csv")
    assert summary["method"].tolist() == ["adaptation only", "nearest point", "adaptation only"]
    assert summary["seed"].tolist() == [0, 1, 1]
    assert (summary["preset"] == "non-isometric").all()
    assert "seed=1" in summary["changes"][1]
    assert "seed=1" not in summary["changes"][0]
    assert set(pd.read_csv(folder / "pairs.csv")["row"]) == set(summary["row"])
    about = storage.read_json(folder / "rows" / summary["row"][2] / "settings.json")
    assert about["settings"]["seed"] == 1
    assert "numpy" in about["versions"]
    assert workflow(*call, *other).code == 0  # the same again replaces its rows
    assert len(pd.read_csv(folder / "summary.csv")) == 3


def test_changed_code_is_not_answered_by_old_results(
    workflow: Workflow, lungs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call = (*words(lungs, tmp_path), "--train", "0:2", "--test", "0:2", "--methods", "features")
    folder = tmp_path / "matching-lungs"
    first = workflow(*call)
    assert first.code == 0, first.stderr
    (matcher,) = folder.glob("matchers/*/matcher-*.pt")
    assert pd.read_csv(matcher.with_name("losses.csv"))["step"].tolist() == [1, 2, 3]
    today = datetime.date.today().isoformat()
    again = workflow(*call)
    assert f"matcher of {today} reused; --fresh trains again" in again.stdout
    assert f"features: 2 of 2 maps of {today} reused" in again.stdout
    fresh = workflow(*call, "--fresh")
    assert "reused" not in fresh.stdout
    for module in (matching_benchmark, benchmark_files):
        digest = module.code_digest
        monkeypatch.setattr(module, "code_digest", lambda *names, old=digest: old(*names) + "new")
    changed = workflow(*call)
    assert "reused" not in changed.stdout
    assert len(list(folder.glob("matchers/*/matcher-*.pt"))) == 2


def test_the_row_spectral_only_has_a_network_of_its_own(
    workflow: Workflow, lungs: Path, runs: Path
) -> None:
    """Beside a matcher that is given, it alone is trained."""
    options = ("--train", "0:2", "--test", "2:4", "--self-pairs", "--steps", "2")
    folder = runs / "matching-lungs"
    before = set(folder.glob("matchers/*/matcher-*.pt"))
    said = workflow(*words(lungs, runs), *options, "--methods", "spectral only")
    assert said.code == 0, said.stderr
    (spectral,) = set(folder.glob("matchers/*/matcher-*.pt")) - before
    row = pd.read_csv(folder / "summary.csv").iloc[-1]
    assert (row["method"], row["pairs"]) == ("spectral only", 4)  # two of them self-pairs
    both = workflow(*words(lungs, runs), *options, "--methods", "spectral only,without adaptation")
    assert both.code == 0, both.stderr
    assert len(set(folder.glob("matchers/*/matcher-*.pt")) - before - {spectral}) == 1


def test_error_is_far_below_chance_and_above_what_the_meshes_allow(
    workflow: Workflow, lungs: Path, runs: Path
) -> None:
    """Rigid alignment and adaptation: near on phantoms that lie as scanned, no network needed."""
    options = ("--methods", "adaptation only", "--test", "0:3")
    said = workflow(*words(lungs, runs), *options)
    assert said.code == 0, said.stderr
    folder = runs / "matching-lungs"
    row = pd.read_csv(folder / "summary.csv").iloc[-1]
    assert row["method"] == "adaptation only"  # nothing was trained, so nothing was seen
    assert row["pairs"] == 6
    shapes = read_matching_folder(lungs)
    mesh, vertices = shapes.meshes[0], shapes.known_pairs([0, 1])[0].on_x
    anywhere = np.random.default_rng(0).permutation(vertices)
    apart = np.linalg.norm(mesh.vertices[vertices] - mesh.vertices[anywhere], axis=1).mean()
    chance = 100 * apart / np.sqrt(area(mesh.vertices, mesh.faces))  # straight: geodesics are more
    assert row["mean_geodesic_error_x100"] < chance / 5
    # A map to the right vertex's neighbours, an edge of an even mesh off, would be near perfect.
    edge = 100 * np.sqrt(2 / (np.sqrt(3) * 560))
    assert row["mean_geodesic_error_x100"] > edge / 4


def test_figures_that_are_built_in(workflow: Workflow, runs: Path) -> None:
    """Made once, in the literature's layout; other settings make others."""
    few = (
        "built_in={training_shapes: 2, test_shapes: 2, persons: 1, vertices: 600}",
        "built_in.template_vertices=500",
    )
    changes = [word for change in (*TINY, *few) for word in ("--set", change)]
    call = ["benchmark", "matching", "--built-in", "articulated", "--runs", str(runs), *changes]
    said = workflow(*call, "--methods", "nearest point")
    assert said.code == 0, said.stderr
    folder = runs / "matching-articulated"
    figures = sorted(folder.glob("shapes/off/*.off"))
    assert len(figures) == 4
    row = pd.read_csv(folder / "summary.csv").iloc[0]
    assert (row["benchmark"], row["shapes"], row["pairs"]) == ("articulated", 2, 2)
    # Rigid alignment of people in other poses is far off, yet not as far as chance.
    assert 3 < row["mean_geodesic_error_x100"] < 60
    stamps = [path.stat().st_mtime_ns for path in figures]
    assert tables(workflow(*call, "--methods", "nearest point")) == tables(said)
    assert [path.stat().st_mtime_ns for path in figures] == stamps
    assert workflow(*call, "--methods", "nearest point", "--set", "built_in.seed=5").code == 0
    assert [path.stat().st_mtime_ns for path in figures] != stamps


def test_meshes_as_the_literature_has_them(workflow: Workflow, lungs: Path, tmp_path: Path) -> None:
    """A vertex whose triangles cancel, one that no triangle uses, a tiny second piece.

    Vertices keep their numbers, so the truth is the same as without.
    """
    shapes = read_matching_folder(lungs)
    folded, loose, pieces = (shapes.meshes[number] for number in (0, 1, 2))
    on_each = [shapes.known_pairs([number, 3])[0].on_x for number in range(3)]
    # Its only triangles are one triangle there and back.
    count = len(folded.vertices)
    a, b = folded.faces[0, :2]
    tip = folded.vertices[[a, b]].mean(axis=0) + np.array([0, 0, 1])
    flap = [[a, b, count], [b, a, count]]
    meshes = [
        Mesh(np.vstack([folded.vertices, tip]), np.vstack([folded.faces, flap]), "folded"),
        Mesh(np.vstack([loose.vertices, loose.vertices[5] + 3]), loose.faces, "loose"),
        Mesh(
            np.vstack([pieces.vertices, pieces.vertices[7] + np.eye(4, 3)]),
            np.vstack([pieces.faces, len(pieces.vertices) + TETRAHEDRON]),
            "pieces",
        ),
    ]
    # Points of the truth lie there too: they must survive.
    last = [len(mesh.vertices) - 1 for mesh in meshes]
    write_matching_folder(tmp_path / "odd", meshes, list(map(np.append, on_each, last)))
    call = words(tmp_path / "odd", tmp_path / "runs")
    said = workflow(*call, "--methods", "full,without adaptation,adaptation only")
    assert said.code == 0, said.stderr
    for name, apart in (("loose", 1), ("pieces", 1)):
        assert f"{name} has {apart} pieces or single vertices apart" in said.stdout
    summary = pd.read_csv(tmp_path / "runs" / "matching-odd" / "summary.csv")
    assert np.isfinite(summary["mean_geodesic_error_x100"]).all()
    assert summary.set_index("method").loc["adaptation only", "mean_geodesic_error_x100"] < 12


def test_every_preset_is_read() -> None:
    folder = Path(__file__).parents[2] / "workflows" / "benchmarks"
    names = {path.stem for path in folder.glob("*.yaml")}
    literature = {"faust", "scape", "shrec19", "topkids", "smal", "dt4d-intra", "dt4d-inter"}
    assert literature | {"articulated", "articulated-shapes", "articulated-merged"} <= names
    for name in names:
        assert read_preset(name).training.steps >= 500
    assert read_preset("dt4d-inter").between == "between categories"
    assert read_preset("articulated-shapes").built_in.family == "non-isometric"


def test_what_can_not_be_done_is_refused(workflow: Workflow, lungs: Path, runs: Path) -> None:
    for options, expected in (
        (("--test", "2:5"), r"--test 2:5 asked of 4 shapes in .*; give a range within 0:4"),
        (("--train", "4:6"), r"--train 4:6 asked of 4 shapes"),
        (("--train", "3"), r"--train 3: no shape's name begins with 3; the first is phantom.000"),
        (("--test", "3:3"), r"--test 3:3: a range such as 80:100 is needed"),
        (("--train", "0:1"), r"training needs at least 2 shapes; --train leaves 1"),
        (("--test", "0:1"), r"no pair of test shapes"),
        (("--checkpoint", "x.pt"), r"--checkpoint x.pt: there is no such file"),
        (("--preset", "isometric"), r"no preset isometric; known: .*near-isometric, non-isometric"),
        (("--methods", "S3M"), r"methods.0: there is no method 'S3M': full, network start"),
        (("--built-in", "articulated"), r"give either --data FOLDER or --built-in"),
    ):
        said = workflow(*words(lungs, runs), *options)
        assert said.code == 1, options
        assert re.search(expected, said.stderr), said.stderr
    said = workflow("benchmark", "matching", "--built-in", "animals")
    assert (
        "the built-in shapes are articulated, articulated-shapes, articulated-merged" in said.stderr
    )

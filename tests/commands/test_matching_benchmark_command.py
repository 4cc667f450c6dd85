"""`workflow benchmark matching` on phantoms, each with a triangulation of its own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import Workflow

from data_prep.matching_folder import read_matching_folder, write_matching_folder
from data_prep.phantom_settings import PhantomSettings
from data_prep.remeshed_phantoms import remeshed_phantoms
from data_prep.smooth_phantoms import draw
from ssm_pipeline.geometry.surface import area

TINY = (
    "spectral.eigenpairs=20",
    "training.steps=3",
    "training.matching={channels: 16, width: 16, blocks: 1, descriptors: 16}",
    "training.interpolation={width: 8, blocks: 1}",
    "adaptation={samples: 500, steps: 3}",
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


def test_trains_on_one_part_and_tests_on_another(workflow: Workflow, lungs: Path, runs: Path):
    said = workflow(*words(lungs, runs), "--train", "0:3", "--test", "2:4")
    assert said.code == 0, said.stderr
    folder = runs / "matching-lungs"
    assert f"tables and curve: {folder}" in said.stdout
    assert (folder / "pck.png").read_bytes().startswith(b"\x89PNG")
    (matcher,) = folder.glob("matcher-*.pt")
    assert not list(folder.glob("checkpoint-*.pt"))
    row = pd.read_csv(folder / "summary.csv").iloc[0]
    assert row["method"] == "full (trained on 1 of the test shapes)"
    assert (row["shapes"], row["pairs"]) == (2, 2)
    pairs = pd.read_csv(folder / "pairs.csv")
    assert set(pairs["x"]) == {"phantom.002", "phantom.003"}
    assert row["mean_geodesic_error_x100"] == pytest.approx(pairs.mean_geodesic_error_x100.mean())
    curve = pd.read_csv(folder / "pck.csv")
    assert curve["share"].is_monotonic_increasing
    assert 0 <= curve["share"].iloc[0] <= curve["share"].iloc[-1] <= 1

    # The same again reads the matcher; one given by --checkpoint is used as it is.
    stamp = matcher.stat().st_mtime_ns
    again = workflow(*words(lungs, runs), "--train", "0:3", "--test", "2:4")
    assert (again.stdout, matcher.stat().st_mtime_ns) == (said.stdout, stamp)
    options = ("--checkpoint", str(matcher), "--test", "2:4")
    given = workflow(*words(lungs, runs, "training.steps=50"), *options)
    assert given.stdout == said.stdout  # 50 steps were not trained
    assert list(folder.glob("matcher-*.pt")) == [matcher]


def test_error_is_far_below_chance_and_above_what_the_meshes_allow(
    workflow: Workflow, lungs: Path, runs: Path
):
    """Rigid alignment and adaptation: near on phantoms that lie as scanned, no network needed."""
    said = workflow(*words(lungs, runs, "method=adaptation only"), "--test", "0:3")
    assert said.code == 0, said.stderr
    folder = runs / "matching-lungs"
    row = pd.read_csv(folder / "summary.csv").iloc[0]
    assert row["method"] == "adaptation only"  # nothing was trained, so nothing was seen
    assert row["pairs"] == 6
    shapes = read_matching_folder(lungs)
    mesh, vertices = shapes.meshes[0], shapes.template_to_shape[0]
    anywhere = np.random.default_rng(0).permutation(vertices)
    apart = np.linalg.norm(mesh.vertices[vertices] - mesh.vertices[anywhere], axis=1).mean()
    chance = 100 * apart / np.sqrt(area(mesh.vertices, mesh.faces))  # straight: geodesics are more
    assert row["mean_geodesic_error_x100"] < chance / 5
    # A map to the right vertex's neighbours, an edge of an even mesh off, would be near perfect.
    edge = 100 * np.sqrt(2 / (np.sqrt(3) * 560))
    assert row["mean_geodesic_error_x100"] > edge / 4


def test_ranges_outside_the_folder_or_of_another_form_are_refused(
    workflow: Workflow, lungs: Path, runs: Path
):
    for options, expected in (
        (("--test", "2:5"), r"--test 2:5 asked of 4 shapes in .*; give a range within 0:4"),
        (("--train", "4:6"), r"--train 4:6 asked of 4 shapes"),
        (("--train", "3"), r"--train 3: a range such as 80:100 is needed"),
        (("--test", "3:3"), r"--test 3:3: a range such as 80:100 is needed"),
        (("--preset", "isometric"), r"no preset isometric; known: near-isometric, non-isometric"),
        (("--set", "method=S3M"), r"method: Input should be 'full', 'without adaptation'"),
    ):
        said = workflow(*words(lungs, runs), *options)
        assert said.code == 1, options
        assert re.search(expected, said.stderr), said.stderr

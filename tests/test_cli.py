"""The `workflow` command, as a user meets it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from command_line import Workflow

ROOT = Path(__file__).parents[1]


def test_help_names_every_command(workflow: Workflow) -> None:
    result = workflow("--help")
    assert result.code == 0
    for command in ("run", "check", "show", "list", "init"):
        assert command in result.stdout


def test_the_module_runs_as_a_program(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ssm_pipeline", "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    for word in ("Usage", "run", "fit", "compare"):
        assert word in done.stdout


def test_list_shows_the_built_in_studies_from_any_folder(workflow: Workflow) -> None:
    result = workflow("list")
    assert result.code == 0
    names = [line.split()[0] for line in result.stdout.splitlines()]
    assert {"luna16", "hippocampus"} <= set(names)
    assert set(names) == {path.stem for path in ROOT.glob("workflows/*.yaml")}


def test_show_prints_settings_that_can_be_run_as_they_are(
    workflow: Workflow, tmp_path: Path
) -> None:
    result = workflow("show", "luna16", "--set", "training.steps=7")
    assert result.code == 0
    shown = yaml.safe_load(result.stdout)
    assert shown["training"]["steps"] == 7
    (tmp_path / "again.yaml").write_text(result.stdout)
    again = workflow("show", "again")
    assert yaml.safe_load(again.stdout) == shown


def test_an_error_is_one_message_without_a_traceback(workflow: Workflow) -> None:
    result = workflow("show", "luna61")
    assert result.code == 1
    assert result.stderr.startswith("error: there is no study luna61. Did you mean luna16?")
    assert "Traceback" not in result.stderr


def test_a_mistyped_setting_is_refused_and_the_nearest_named(
    workflow: Workflow, tmp_path: Path
) -> None:
    result = workflow("run", "luna16", "--set", "training.stpes=5")
    assert result.code == 1
    assert "there is no setting training.stpes. Did you mean steps?" in result.stderr
    assert not (tmp_path / "runs").exists()


def test_a_study_without_masks_and_without_stand_in_says_what_to_do(workflow: Workflow) -> None:
    result = workflow("run", "hippocampus")
    assert result.code == 1
    assert "study hippocampus needs masks. Pass --data FOLDER" in result.stderr
    Path("livers.yaml").write_text("data: {source: meshes}\n")
    for command in ("run", "check"):
        assert "study livers needs surfaces. Pass --data" in workflow(command, "livers").stderr


def test_init_check_and_show_of_a_new_study(workflow: Workflow, sphere_masks: Path) -> None:
    made = workflow("init", "balls", "--masks", str(sphere_masks), "--label", "3")
    assert made.code == 0, made.stderr
    assert "workflow check balls" in made.stdout
    shown = yaml.safe_load(workflow("show", "balls").stdout)
    assert shown["data"]["labels"] == [3]
    assert Path(shown["data"]["folder"]) == sphere_masks
    checked = workflow("check", "balls")
    assert checked.code == 0, checked.stdout + checked.stderr
    assert "4 of 4 can be read" in checked.stdout
    again = workflow("init", "balls", "--masks", str(sphere_masks), "--label", "3")
    assert again.code == 1
    assert "exists" in again.stderr
    other = workflow("init", "v1.2.yaml", "--masks", str(sphere_masks), "--label", "3")
    assert "wrote v1.2.yaml. Look it over, then: workflow check v1.2\n" in other.stdout


def test_init_on_surfaces_segments_and_probability_maps(
    workflow: Workflow, sphere_masks: Path
) -> None:
    import trimesh

    surfaces = sphere_masks.parent / "surfaces"
    surfaces.mkdir()
    for index in range(3):
        trimesh.creation.icosphere(3, radius=0.02 + 0.001 * index).export(surfaces / f"{index}.stl")
    made = workflow("init", "shells", "--meshes", str(surfaces), "--unit", "m")
    assert made.code == 0, made.stderr
    shown = yaml.safe_load(workflow("show", "shells").stdout)
    assert (shown["data"]["source"], shown["data"]["unit"]) == ("meshes", "m")
    assert shown["description"] == "3 surfaces of surfaces"
    soft = workflow("init", "soft", "--masks", str(sphere_masks), "--threshold", "0.5")
    assert soft.code == 0, soft.stderr
    assert yaml.safe_load(workflow("show", "soft").stdout)["data"]["threshold"] == 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--masks", "{masks}", "--label", "0"), "label 0 is the background"),
        (("--masks", "{masks}"), "give only one of --label, --segment and --threshold"),
        (("--masks", "{masks}", "--label", "1", "--segment", "liver"), "give only one of"),
        (("--masks", "{masks}", "--meshes", "{masks}"), "give one folder"),
        ((), "give one folder"),
        (("--masks", "{masks}", "--label", "3", "--pattern", "/etc/*"), "the pattern '/etc/*'"),
        (("--masks", "{masks}", "--label", "3", "--pattern", ""), "the pattern ''"),
        (("--meshes", "{masks}"), "there are no surfaces"),
        (("--masks", "{masks}", "--segment", "liver"), "there are no segmentations"),
        (("--masks", "{masks}", "--label", "3", "--mirror", "up"), "mirror: Input should be"),
        (("--masks", "{masks}", "--label", "3", "--mirror", "left"), "does not say its side"),
    ],
)
def test_init_refuses(
    workflow: Workflow, sphere_masks: Path, options: tuple[str, ...], message: str
) -> None:
    words = [word.format(masks=sphere_masks) for word in options]
    result = workflow("init", "balls", *words)
    assert result.code == 1
    assert message in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("name", ["..", ".", "a/b", "../a"])
def test_init_writes_into_this_folder_alone(
    workflow: Workflow, sphere_masks: Path, name: str
) -> None:
    result = workflow("init", name, "--masks", str(sphere_masks), "--label", "3")
    assert result.code == 1
    assert f"{name} is not a plain name" in result.stderr


def test_check_names_the_case_that_lacks_the_label(workflow: Workflow, sphere_masks: Path) -> None:
    workflow("init", "balls", "--masks", str(sphere_masks), "--label", "4")
    checked = workflow("check", "balls")
    assert checked.code == 1
    assert "case ball_0" in checked.stdout
    assert "label" in checked.stdout


def test_check_names_excluded_cases_with_their_reason_and_broken_files(
    workflow: Workflow, sphere_masks: Path
) -> None:
    workflow("init", "balls", "--masks", str(sphere_masks), "--label", "3")
    whole = (sphere_masks / "ball_1.nii.gz").read_bytes()
    (sphere_masks / "ball_9.nii.gz").write_bytes(whole[: len(whole) // 2])
    checked = workflow("check", "balls", "--set", "data.exclude={ball_0: motion}")
    assert checked.code == 1  # a file that can't be read is not passed over
    assert "case ball_0: excluded: motion" in checked.stdout
    assert re.search(r"case ball_9: .*ball_9\.nii\.gz", checked.stdout)
    assert "3 of 4 can be read" in checked.stdout
    both = workflow("check", "balls", "--set", "data.exclude={ball_9: cut off}")
    assert both.code == 0, both.stdout
    assert "case ball_9: excluded: cut off" in both.stdout
    assert "4 of 4 can be read" in both.stdout
    unknown = workflow("check", "balls", "--set", "data.exclude={ball_7: motion}")
    assert unknown.code == 1
    assert "data.exclude: there is no case ball_7" in unknown.stderr


@pytest.fixture
def sphere_masks(tmp_path: Path) -> Path:
    """Four label images with a ball of label 3."""
    import numpy as np
    import SimpleITK as sitk

    folder = tmp_path / "masks"
    folder.mkdir()
    z, y, x = np.indices((40, 40, 40)) - 20
    for index in range(4):
        ball = (x**2 + y**2 + z**2 < (10 + index) ** 2).astype(np.uint8) * 3
        sitk.WriteImage(sitk.GetImageFromArray(ball), str(folder / f"ball_{index}.nii.gz"))
    return folder


def test_an_installed_wheel_finds_its_studies_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What pyproject.toml puts into the wheel is where `study_folders` looks."""
    from ssm_pipeline.study import study

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included == {
        "data_prep": "ssm_pipeline/data_prep",
        "workflows": "ssm_pipeline/workflows",
    }
    package = tmp_path / "site-packages" / "ssm_pipeline"
    shutil.copytree(ROOT / "workflows", package / "workflows")
    monkeypatch.setattr(study, "files", lambda name: package)
    empty = tmp_path / "elsewhere"
    empty.mkdir()
    monkeypatch.chdir(empty)
    assert study.find_study("luna16") == package / "workflows" / "luna16.yaml"
    assert set(study.study_paths()) == {path.stem for path in ROOT.glob("workflows/*.yaml")}

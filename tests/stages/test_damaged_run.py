"""A real run with damaged and missing results: they are made again, to the same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tiny_study import NAME, run_tiny, tiny_settings

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile
from ssm_pipeline.runs.run import load_run

MADE = (".npz", ".pt", ".csv", ".html")


@pytest.fixture
def copy(tiny_run: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / NAME
    shutil.copytree(tiny_run, folder)
    return folder


def results(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.suffix in MADE and "report" not in path.parts  # the page shows seconds
    }


def masks_of(tiny_run: Path) -> Path:
    return tiny_run.parent.parent / "masks"


def test_damaged_results_are_made_again_to_the_same_bytes(
    tiny_run: Path, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = results(copy)
    mesh = copy / "meshing" / "ball_1" / "mesh.npz"
    mesh.write_bytes(mesh.read_bytes()[:-100])
    (copy / "training" / "matcher.pt").write_bytes(b"")
    (copy / "training" / "checkpoint-0.pt").write_bytes(b"")
    (copy / "shape_model" / "model.npz").unlink()
    (copy / "report" / "index.html").unlink()
    basis = copy / "spectral" / "ball_2" / "training_basis.npz"
    flipped = bytearray(basis.read_bytes())  # of the same size: found when it is read
    flipped[len(flipped) // 2] ^= 1
    basis.write_bytes(flipped)
    run_tiny(masks_of(tiny_run), copy.parent)
    said = capsys.readouterr().out
    for name in ("ball_1/mesh.npz", "training_basis.npz"):  # the later stages were redone anyway
        assert name in said, said
    assert results(copy) == whole
    assert (copy / "report" / "index.html").stat().st_size > 10_000


def test_training_starts_afresh_after_a_damaged_checkpoint(tiny_run: Path, copy: Path) -> None:
    whole = results(copy)
    key = load_run(copy).stages[3].key
    (copy / "training" / "matcher.pt").unlink()
    (copy / "training" / f"checkpoint-{key}.pt").write_bytes(b"")
    run_tiny(masks_of(tiny_run), copy.parent)
    assert results(copy) == whole


def test_reading_a_damaged_run_says_what_to_do(copy: Path) -> None:
    (copy / "shape_model" / "model.npz").write_bytes(b"PK")
    with pytest.raises(DamagedFile, match=r"model\.npz is damaged .* run the study again"):
        _ = load_run(copy).model


def test_a_run_made_before_sizes_were_kept_goes_on(tiny_run: Path, copy: Path) -> None:
    """Nothing is known of its files, so that only a look inside can find damage."""
    import json

    for record in [*copy.rglob("stage.json"), *copy.rglob("case.json")]:
        content = json.loads(record.read_text())
        content.pop("files")
        content.pop("ran_on", None)
        record.write_text(json.dumps(content))
    run_study(NAME, tiny_settings(masks_of(tiny_run)), RunOptions(copy.parent), Terminal())
    assert load_run(copy).model.mode_count == 3


@pytest.mark.parametrize("when", ["at its writing", "after the run"])
def test_s3ms_losses_are_made_again_from_its_network(tiny_run: Path, copy: Path, when: str) -> None:
    whole = results(copy)
    losses = copy / "evaluation" / "S3M" / "losses.csv"
    losses.write_bytes(losses.read_bytes()[:-9])
    if when == "at its writing":  # the network was kept before, and nothing came after
        for name in ("evaluation", "report"):
            (copy / name / "stage.json").unlink()
        shutil.rmtree(losses.with_name("shapes"))
    run_tiny(masks_of(tiny_run), copy.parent)
    assert results(copy) == whole


def test_s3ms_network_is_trained_again(tiny_run: Path, copy: Path) -> None:
    whole = results(copy)
    (network,) = (copy / "evaluation" / "S3M").glob("network-*.pt")
    network.write_bytes(network.read_bytes()[:-9])
    run_tiny(masks_of(tiny_run), copy.parent)
    assert results(copy) == whole

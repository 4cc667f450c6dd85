"""All nine stages on four small shapes: what they leave, cached, continued after a kill."""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console
from tiny_study import run_tiny, tiny_settings, without_comparison, write_balls

import ssm_pipeline
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.training.loss import pair_loss


def listening() -> tuple[Terminal, io.StringIO]:
    out = io.StringIO()
    return Terminal(Console(file=out, soft_wrap=True, markup=False, highlight=False)), out


def test_every_stage_leaves_its_record_and_the_page_is_written(tiny_run: Path) -> None:
    run = ssm_pipeline.load_run(tiny_run)
    assert {record.stage for record in run.stages} == {stage.name for stage in STAGES}
    assert all(record.cases_out == list(run.cases) for record in run.stages)
    assert run.dropped == ()
    assert (tiny_run / "report" / "index.html").stat().st_size > 10_000


def test_the_model_is_of_the_masks_in_patient_millimetres(tiny_run: Path) -> None:
    run = ssm_pipeline.load_run(tiny_run)
    assert run.model.mode_count == 3  # four cases
    for case_id, shape in zip(run.shapes.case_ids, run.shapes.vertices, strict=True):
        mesh = run.mesh(case_id)
        extent = np.ptp(mesh.vertices, axis=0)
        assert 36 < extent.min() < extent.max() < 66  # axes of 22 … 31.5 mm, twice, by eye
        on_surface = closest_points(shape, mesh.vertices, mesh.faces)
        assert on_surface.distances.max() < 1e-6  # correspondences lie on the case's own surface


def test_shapes_frames_and_aligned_shapes_agree(tiny_run: Path) -> None:
    run = ssm_pipeline.load_run(tiny_run)
    for index, case_id in enumerate(run.cases):
        moved = run.frames[case_id].apply(run.shapes.vertices[index])
        np.testing.assert_allclose(moved, run.aligned.vertices[index], atol=1e-9)
    np.testing.assert_allclose(run.aligned.vertices.mean(axis=0), run.model.mean, atol=1e-9)


def test_metrics_hold_every_method(tiny_run: Path) -> None:
    tables = ssm_pipeline.load_run(tiny_run).metrics.tables
    methods = {"full", "adaptation only", "S3M"}
    for name in ("compactness", "generalisation", "generalisation_mean", "specificity"):
        assert set(tables[name]["method"]) == methods, name
    assert set(tables["comparison"]["method"]) == methods
    assert set(tables["generalisation"]["points"]) == {200}  # as set; S3M, with fewer, as well


def test_interpolations_are_measured(tiny_run: Path) -> None:
    """A row per stored time of each path, beside it the straight line between the same ends."""
    run = ssm_pipeline.load_run(tiny_run)
    table = run.metrics.tables["interpolation"]
    (case_id,) = run.path_cases
    assert table["t"].tolist() == run.path(case_id).times.tolist()
    assert set(table["case_id"]) == {case_id}
    for column in ("conformal_distortion", "straight_conformal_distortion"):
        assert table[column].iloc[0] == pytest.approx(2)
        assert (table[column] >= 2 - 1e-9).all()
    ends = table.iloc[-1]
    assert ends["conformal_distortion"] == pytest.approx(ends["straight_conformal_distortion"])


ABLATIONS = ("without groupwise", "spectral only", "adaptation only", "adaptation only, groupwise")


def test_ablations_are_methods_of_their_own(tiny_run: Path, tmp_path: Path) -> None:
    """The row `spectral` has a network of its own; a second evaluation trains it no more."""
    masks, copy = tiny_run.parent.parent / "masks", tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    settings = tiny_settings(masks)
    comparison = settings.comparison.model_copy(update={"methods": ABLATIONS})
    # A network of six steps loses against the rigid start, and full would be adaptation only.
    adaptation = settings.adaptation.model_copy(update={"starts": "network"})
    settings = settings.model_copy(update={"comparison": comparison, "adaptation": adaptation})
    stamps = set()
    for _ in range(2):
        run_study(copy.name, settings, RunOptions(copy.parent), Terminal())
        settings = settings.model_copy(
            update={"evaluation": settings.evaluation.model_copy(update={"samples": 21})}
        )
        (matcher,) = (copy / "evaluation" / "spectral-only").glob("matcher-*.pt")
        content = torch.load(matcher, weights_only=True)
        assert '"arap":0' in content["settings"].replace(" ", "")
        stamps.add(matcher.stat().st_mtime_ns)
    assert len(stamps) == 1
    tables = ssm_pipeline.load_run(copy).metrics.tables
    assert set(tables["comparison"]["method"]) == {"full", *ABLATIONS}
    fit = tables["generalisation_mean"].groupby("method")["correspondence_mm"].last()
    assert fit.nunique() == len(fit)  # each row is a method of its own
    saw = tables["generalisation"].groupby("method")["matching_saw_case"].all()
    assert saw.index[~saw].tolist() == ["adaptation only"]


def test_path_of_a_case_without_one_says_so(tiny_run: Path) -> None:
    run = ssm_pipeline.load_run(tiny_run)
    (with_path,) = run.path_cases
    assert run.path(with_path).at(0.0).shape == run.model.mean.shape
    other = next(case for case in run.cases if case != with_path)
    with pytest.raises(StudyError, match=r"path\.npz"):
        run.path(other)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="holds no run"):
        ssm_pipeline.load_run(tmp_path)


def test_a_second_run_does_nothing(tiny_run: Path) -> None:
    stamps = {path: path.stat().st_mtime_ns for path in tiny_run.rglob("*.npz")}
    terminal, said = listening()
    run_tiny(tiny_run.parent.parent / "masks", tiny_run.parent, terminal=terminal)
    assert "nothing to do" in said.getvalue()
    assert stamps == {path: path.stat().st_mtime_ns for path in tiny_run.rglob("*.npz")}


class PowerCut(BaseException):
    """Ends a run at once, as Ctrl-C does; no handler of errors catches it."""


def test_training_goes_on_from_its_checkpoint_to_the_same_bits(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run cut off after 5 of 6 steps goes on after step 4 and ends with the same networks."""
    masks = tiny_run.parent.parent / "masks"
    copy = tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    shutil.rmtree(copy / "training")
    from ssm_pipeline.training import train as module

    calls: list[int] = []

    def counted(*arguments: Any) -> Any:
        calls.append(1)
        return pair_loss(*arguments)

    def cut_at_the_sixth(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 6:
            raise PowerCut
        return pair_loss(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(module, "pair_loss", cut_at_the_sixth)
        with pytest.raises(PowerCut):
            run_tiny(masks, copy.parent)
    assert len(list((copy / "training").glob("checkpoint-*.pt"))) == 1
    with pytest.raises(StudyError, match="the stage shape_model is not finished"):
        _ = ssm_pipeline.load_run(copy).model  # it is there, and it is of the past

    terminal, said = listening()
    with monkeypatch.context() as patch:
        patch.setattr(module, "pair_loss", counted)
        run_tiny(masks, copy.parent, terminal=terminal)
    assert "training goes on after step 4" in said.getvalue()
    assert len(calls) == 6 + 2
    assert not list((copy / "training").glob("checkpoint-*.pt"))
    first, second = (
        torch.load(folder / "training" / "matcher.pt", weights_only=True)
        for folder in (tiny_run, copy)
    )
    for network, weights_by_name in first["networks"].items():
        for name, weights in weights_by_name.items():
            assert torch.equal(weights, second["networks"][network][name]), name
    assert (copy / "training" / "losses.csv").read_text() == (
        tiny_run / "training" / "losses.csv"
    ).read_text()


def test_a_mask_without_the_organ_is_dropped_and_named_in_the_report(tmp_path: Path) -> None:
    import SimpleITK as sitk

    masks = write_balls(tmp_path / "masks", count=4)
    empty = sitk.GetImageFromArray(np.zeros((10, 10, 10), dtype=np.uint8))
    sitk.WriteImage(empty, str(masks / "ball_nobody.nii.gz"))
    terminal, said = listening()
    settings = without_comparison(tiny_settings(masks, steps=1))
    run = ssm_pipeline.load_run(
        run_study("balls", settings, RunOptions(tmp_path / "runs"), terminal)
    )
    assert "4 of 5 cases" in said.getvalue()
    assert "dropped ball_nobody: " in said.getvalue()
    assert [case.case_id for case in run.dropped] == ["ball_nobody"]
    assert "ball_nobody" in (run.folder / "report" / "index.html").read_text(encoding="utf-8")


def test_more_interpolations_match_no_pair_again(tiny_run: Path, tmp_path: Path) -> None:
    """A choice of display: the correspondences stay, and fewer paths leave none behind."""
    masks, copy = tiny_run.parent.parent / "masks", tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    settings = tiny_settings(masks)
    matches = sorted((copy / "correspondence").glob("*/correspondence.npz"))
    before = [path.stat().st_mtime_ns for path in matches]
    for count in (2, 1):
        report = settings.report.model_copy(update={"paths": count})
        changed = settings.model_copy(update={"report": report})
        run_study(copy.name, changed, RunOptions(copy.parent), Terminal())
        assert len(ssm_pipeline.load_run(copy).path_cases) == count
        assert [path.stat().st_mtime_ns for path in matches] == before

"""The evaluation of a study whose truth is known, and `workflow benchmark phantoms` over it."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from tiny_study import tiny_settings

from ssm_pipeline import load_run
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments import varied_studies
from ssm_pipeline.experiments.phantom_benchmark import run_phantom_benchmark
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import PhantomData


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> StudySettings:
    tiny = tiny_settings(tmp_path_factory.mktemp("none"), steps=1)
    only_s3m = tiny.comparison.model_copy(update={"methods": ("S3M",)})
    phantoms = PhantomData(family="smooth", cases=4, modes=2, spacing_mm=(5.0, 5.0, 6.0))
    return tiny.model_copy(update={"data": phantoms, "comparison": only_s3m})


@pytest.fixture(scope="module")
def folder(settings: StudySettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run up to its evaluation."""
    options = RunOptions(tmp_path_factory.mktemp("runs"))
    return run_study("phantoms-as-scanned", settings, options, Terminal(), STAGES[:-1])


def test_the_truth_is_known_of_every_method(folder: Path) -> None:
    tables = load_run(folder).metrics.tables
    methods = {"full", "S3M", "true correspondence"}
    assert set(tables["comparison"]["method"]) == methods
    errors = tables["truth"]
    assert errors.groupby("method").size().to_dict() == dict.fromkeys(methods, 3)  # no template
    means = tables["truth_mean"].set_index("method")
    for method in methods:
        own = errors.loc[errors["method"] == method, "geodesic_mm"].mean()
        assert means.loc[method, "geodesic_mm"] == pytest.approx(own)
    # The truth against itself: what is left is the rounding of the single-precision solver.
    assert means.loc["true correspondence", "geodesic_mm"] < 0.1
    assert means.loc["true correspondence", "off_surface_mm"] < 1e-3
    assert means.loc["full", "geodesic_mm"] > 1  # one step of training
    kept = tables["comparison"].set_index("method")["variance_kept_percent"]
    assert kept["true correspondence"] == pytest.approx(100)
    assert "variance_kept" not in tables  # it stands beside specificity
    assert list(tables["comparison_95"]["variance_kept_percent"]) == kept.to_list()


def test_the_modes_of_the_truth_are_looked_for(folder: Path) -> None:
    table = load_run(folder).metrics.tables["recovered_modes"]
    assert table["mode"].tolist() == [1, 2]
    assert (table["floor_angle_degrees"] < 5).all()  # the true correspondences hold both modes
    assert (table["angle_degrees"] > table["floor_angle_degrees"]).all()


def test_fit_of_every_method_and_none_of_the_papers_numbers(folder: Path) -> None:
    tables = load_run(folder).metrics.tables
    assert set(tables["fit"]["method"]) == {"full", "S3M", "true correspondence"}
    s3m = tables["fit"].set_index("method").loc["S3M"]
    assert s3m["flipped_percent"] > 0  # its points are joined to a surface, scored like any other
    assert s3m["to_case_mm"] < 1e-3  # its points are vertices of the meshes
    assert "paper" not in tables  # phantoms are no LUNA16


def test_every_cohort_as_scanned_and_turned(
    folder: Path, settings: StudySettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The runs themselves are the business of other tests: a finished one stands for both."""
    asked: dict[str, StudySettings] = {}

    def finished(study: str, wanted: StudySettings, *rest: object) -> Path:
        asked[study] = wanted
        return folder

    monkeypatch.setattr(varied_studies, "run_study", finished)
    means, modes = run_phantom_benchmark(settings, RunOptions(tmp_path), Terminal(), seeds=(3, 4))
    drawn = {}
    for name, wanted in asked.items():
        assert isinstance(wanted.data, PhantomData)
        drawn[name] = (wanted.data.max_rotation_deg, wanted.data.seed, wanted.seed)
    assert drawn == {
        "phantoms-smooth-as-scanned-3": (0.0, 3, settings.seed),
        "phantoms-smooth-as-scanned-4": (0.0, 4, settings.seed),
        "phantoms-smooth-turned-3": (40.0, 3, settings.seed),
        "phantoms-smooth-turned-4": (40.0, 4, settings.seed),
    }
    table = pd.read_csv(tmp_path / "phantom-benchmark.csv")
    pd.testing.assert_frame_equal(means, pd.read_csv(tmp_path / "phantom-benchmark-mean.csv"))
    pd.testing.assert_frame_equal(modes, pd.read_csv(tmp_path / "phantom-modes.csv"))
    assert table.groupby(["pose", "cohort"]).size().to_list() == [3] * 4
    assert not table.isna().any(axis=None)
    assert (table["affine_percent"] > 80).all()  # of the smooth family
    assert means["cohorts"].tolist() == [2] * 6
    assert (means["geodesic_mm_sd"] == 0).all()  # the same run stands for both
    rivals = means.set_index("method").loc["S3M"]
    errors = load_run(folder).metrics.tables["truth"]
    errors = errors.pivot(index="case_id", columns="method", values="geodesic_mm").dropna()
    difference = (errors["S3M"] - errors["full"]).mean()  # of the cases that both score
    assert rivals["geodesic_difference_mm"].to_numpy() == pytest.approx(difference)
    assert (rivals["geodesic_low_mm"] <= rivals["geodesic_difference_mm"]).all()
    assert (rivals["geodesic_difference_mm"] <= rivals["geodesic_high_mm"]).all()
    compared = means.dropna(subset="geodesic_p")
    assert set(compared["method"]) == {"S3M"}
    assert modes["mode"].tolist() == [1, 2] * 4
    comparison = load_run(folder).metrics.tables["comparison"].set_index("method")
    row = means.set_index(["pose", "method"]).loc[("turned", "full")]
    assert row["generalisation_mm"] == comparison.loc["full", "generalisation_chamfer_mm"]
    assert row["specificity_mm"] == comparison.loc["full", "specificity_chamfer_mm"]
    assert row["variance_kept_percent"] == comparison.loc["full", "variance_kept_percent"]


def test_it_wants_phantoms(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"set data\.source to phantoms"):
        run_phantom_benchmark(tiny_settings(tmp_path), RunOptions(tmp_path), Terminal())

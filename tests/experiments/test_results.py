"""`workflow benchmark results`: parts, what is written of them, and printed figures checked."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tiny_study import tiny_settings

from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments import results as making
from ssm_pipeline.experiments import varied_studies
from ssm_pipeline.experiments.results_file import (
    figures_in,
    read_results,
    row_names,
    write_part,
)
from ssm_pipeline.experiments.results_parts import PARTS, Part
from ssm_pipeline.experiments.s3m_epochs import score_s3m_epochs
from ssm_pipeline.experiments.spread import run_spread
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import load_run

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from fill_tables import RESULTS, TABLE, filled, pages, table_from  # noqa: E402

TABLE_OF_TWO = pd.DataFrame({"method": ["full", "S3M"], "x_mm": [2.4567, -3.0], "cases": [22, 22]})


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_tables_of_the_pages_hold_the_results(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert filled(text, figures_in(RESULTS)) == text
    assert text.count("<!--") == text.count("<!-- table: ") + text.count("<!-- end of table -->")


def test_every_template_is_used_once() -> None:
    used = [name for page in pages() for _, name, _ in TABLE.findall(page.read_text("utf-8"))]
    assert sorted(used) == sorted(path.stem for path in (RESULTS / "tables").glob("*.txt"))


def test_figures_have_names_and_are_rounded_as_printed(tmp_path: Path) -> None:
    write_part(tmp_path, "lungs", {"seed": 0}, {"comparison": TABLE_OF_TWO})
    figures = figures_in(tmp_path)
    assert figures["lungs/comparison/full/x_mm"] == 2.4567
    assert figures["lungs/comparison/S3M/cases"] == 22
    template = "| {lungs/comparison/full/x_mm:.2f} | {lungs/comparison/S3M/x_mm:.0f} |"
    (tmp_path / "two.txt").write_text(template + "\n")
    page = "Before.\n\n<!-- table: two -->\nold\n<!-- end of table -->\n\nAfter."
    made = filled(page, figures, tmp_path)
    assert made == page.replace("old", "\n| 2.46 | -3 |\n")
    assert filled(made, figures, tmp_path) == made
    with pytest.raises(KeyError, match="lungs/comparison/best/x_mm"):
        table_from("{lungs/comparison/best/x_mm:.1f}", figures)


def test_a_part_made_again_replaces_itself_and_nothing_else(tmp_path: Path) -> None:
    write_part(tmp_path, "lungs", {"seed": 0}, {"comparison": TABLE_OF_TWO, "old": TABLE_OF_TWO})
    write_part(tmp_path, "phantoms", {"seed": 1}, {"comparison": TABLE_OF_TWO})
    write_part(tmp_path, "lungs", {"seed": 2}, {"comparison": TABLE_OF_TWO})
    assert sorted(p.name for p in (tmp_path / "lungs").glob("*")) == ["comparison.csv"]
    parts = read_results(tmp_path)["parts"]
    assert (parts["lungs"]["seed"], parts["phantoms"]["seed"]) == (2, 1)
    assert parts["lungs"]["tables"] == ["comparison"]


def test_rows_that_words_do_not_tell_apart_get_their_numbers() -> None:
    table = pd.DataFrame({"method": ["a", "a"], "modes": [1, 2], "x_mm": [0.0, 1.0]})
    assert row_names(table) == ["a, 1", "a, 2"]


def test_parts_are_made_from_runs_and_say_how(
    tmp_path: Path, tiny_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def run_study(name: Any, settings: Any, options: Any, terminal: Any) -> Any:
        asked.append((name, settings.evaluation.folds, options.runs))
        return tiny_run

    monkeypatch.setattr(making, "run_study", run_study)
    options, terminal = RunOptions(tmp_path / "runs"), Terminal()
    parts = (
        Part("balls", "study", "phantoms", changes=("evaluation.folds=3",)),
        Part("lungs", "study", "luna16", needs="lungs"),
    )
    folder = tmp_path / "results"
    made = making.make_results(folder, {}, options, terminal, parts=parts)
    assert made == ["balls"]  # the other's data was not given
    assert asked == [("phantoms", 3, tmp_path / "runs" / "results" / "balls")]
    facts = read_results(folder)["parts"]["balls"]
    assert facts["changes"] == ["evaluation.folds=3"]
    assert facts["seed"] == 0
    assert facts["minutes"] >= 0
    assert facts["machine"]
    assert "numpy" in facts["packages"]
    assert "balls/comparison/full/generalisation_surface_mm" in figures_in(folder)
    assert (folder / "balls" / "s3m_losses.csv").exists()
    with pytest.raises(StudyError, match="no part ball; the parts: balls, lungs"):
        making.make_results(folder, {}, options, terminal, ["ball"], parts=parts)
    with pytest.raises(StudyError, match="lungs needs --data lungs=FOLDER"):
        making.make_results(folder, {}, options, terminal, ["lungs"], parts=parts)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_every_parts_changes_are_settings(part: Part, tmp_path: Path) -> None:
    data = {} if part.needs is None else {part.needs: tmp_path}
    making._settings(part, data, making._changes(part, ["seed=1"]))


def test_what_is_asked_counts_over_what_a_part_sets(
    tmp_path: Path, tiny_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def keep(name: str, settings: Any, *rest: Any) -> Path:
        asked.append(settings)
        return tiny_run

    monkeypatch.setattr(making, "run_study", keep)
    part = Part("balls", "study", "phantoms", changes=("evaluation.folds=3", "seed=1"))
    making.make_results(
        tmp_path, {}, RunOptions(tmp_path), Terminal(), (), ["evaluation.folds=4"], [part]
    )
    assert (asked[0].evaluation.folds, asked[0].seed) == (4, 1)
    assert read_results(tmp_path)["parts"]["balls"]["changes"] == ["seed=1", "evaluation.folds=4"]


def test_spread_repeats_the_study_with_seeds_and_templates(
    tmp_path: Path, tiny_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def run_study(name: Any, settings: Any, options: Any, terminal: Any) -> Any:
        asked.append((name, settings.seed, settings.template))
        return tiny_run

    monkeypatch.setattr(varied_studies, "run_study", run_study)
    settings = tiny_settings(tmp_path)
    options, terminal = RunOptions(tmp_path / "runs"), Terminal()
    runs, each, mean = run_spread("balls", settings, options, terminal, templates=2)
    seeds, (last,) = asked[:3], asked[3:]
    assert [seed for _, seed, _ in seeds] == [0, 1, 2]
    assert last[2] in load_run(tiny_run).cases
    assert last[2] != load_run(tiny_run).template_id
    assert len(runs) == 4
    assert each.groupby("varied").size().to_dict() == {"seed": 9, "template": 6}
    # All repetitions are the same run here, so nothing varies.
    assert mean.filter(like="_sd_").to_numpy() == pytest.approx(0)
    assert set(mean["method"]) == {"full", "adaptation only", "S3M"}


def test_s3m_is_scored_at_the_epochs_that_its_training_kept(tiny_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    table = score_s3m_epochs(copy, Terminal())
    assert table["method"].tolist() == ["S3M", "S3M tuned"]
    assert table["epochs"].tolist() == [1, 1]
    losses = pd.read_csv(copy / "evaluation" / "S3M" / "losses.csv")
    assert table["loss"].tolist() == pytest.approx([losses["loss"].iloc[-1]] * 2)
    # The same network, filter and draws as the run's own row: the same score.
    row = load_run(copy).metrics.tables["comparison"].set_index("method").loc["S3M"]
    assert table["generalisation_surface_mm"][0] == pytest.approx(
        row["generalisation_surface_mm"], rel=1e-6
    )
    with pytest.raises(StudyError, match="no network of S3M after 7 epochs"):
        score_s3m_epochs(copy, Terminal(), epochs=[7])

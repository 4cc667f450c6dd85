"""`workflow benchmark training`: one run, its training changed."""

from pathlib import Path
from typing import Any

import pytest
from tiny_study import tiny_settings

from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments import varied_studies
from ssm_pipeline.experiments.training_curve import Schedule, run_training_curve
from ssm_pipeline.runs.run import load_run


def test_a_row_per_schedule_and_method_with_one_template(
    tmp_path: Path, tiny_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def run_study(name: Any, settings: Any, options: Any, terminal: Any) -> Any:
        training = settings.training
        asked.append((name, training.start, training.steps, training.patience, settings.template))
        return tiny_run

    monkeypatch.setattr(varied_studies, "run_study", run_study)
    schedules = (Schedule("none", 3), Schedule("built-in", 0), Schedule("none", 9, patience=2))
    folder, table = run_training_curve(
        "balls", tiny_settings(tmp_path), RunOptions(tmp_path / "runs"), Terminal(), schedules
    )
    assert folder == tiny_run
    run = load_run(tiny_run)
    assert [words[:4] for words in asked] == [
        ("balls-training", "none", 3, 0),
        ("balls-training", "built-in", 0, 0),
        ("balls-training", "none", 9, 2),
    ]
    assert [words[4] for words in asked[1:]] == [run.template_id] * 2
    found = run.metrics.tables["comparison"].set_index("method")["generalisation_surface_mm"]
    one = table[table["steps"] == 9].set_index("method")["generalisation_surface_mm"]
    assert one.to_dict() == pytest.approx(found.to_dict())
    assert len(table) == 3 * len(found)
    assert (table["mean_loss"] > 0).all()
    assert (tmp_path / "runs" / "balls-training.csv").exists()

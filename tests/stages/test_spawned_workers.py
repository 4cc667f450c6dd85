"""Per-case work in processes as Windows and macOS start them."""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from typing import Any

import pytest
from tiny_study import NAME, tiny_settings, write_balls

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.per_case import run_case
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.stage import StageContext
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.stages.list import STAGES


def test_each_stages_work_runs_in_a_fresh_interpreter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Spawned: it inherits nothing, and pickle alone tells it what to do."""
    found: dict[str, Any] = {}
    map_cases = StageContext.map_cases

    def first_case_apart(context: StageContext[Any], tasks: Any, *rest: Any, **words: Any) -> Any:
        results = map_cases(context, tasks, *rest, **words)
        if context.name not in found:
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                again = pool.apply(run_case, (tasks[0], tmp_path / "apart" / context.name))
            found[context.name] = (results[0], again)
        return results

    monkeypatch.setattr(StageContext, "map_cases", first_case_apart)
    settings = tiny_settings(write_balls(tmp_path / "masks")).model_copy(
        update={"matching": "none"}
    )
    stages = STAGES[: [stage.name for stage in STAGES].index("shape_model")]
    run_study(NAME, settings, RunOptions(tmp_path / "runs"), Terminal(), stages)
    assert set(found) == {"meshing", "cohort_check", "spectral", "correspondence", "groupwise"}
    for here, apart in found.values():
        assert apart.dropped is None
        assert (apart.key, apart.row) == (here.key, here.row)
        assert set(apart.files) == set(here.files)

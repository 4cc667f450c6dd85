"""A real run, masks to report, on two Dask workers, one of which is killed on the way."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from dask_bench import DaskBench
from faults import results_in
from tiny_study import NAME, tiny_settings

pytest.importorskip("distributed")

from ssm_pipeline.commands.cluster import cluster_at
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.run_log import read_events
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal


@pytest.mark.slow  # the engine's own tests lose a worker of a toy study
def test_a_run_on_a_cluster_that_loses_a_worker_leaves_the_bytes_of_one_machine(
    tiny_run: Path, tmp_path: Path
) -> None:
    runs, terminal = tmp_path / "runs", Terminal()
    (tmp_path / "dask").mkdir()
    settings = tiny_settings(tiny_run.parent.parent / "masks")

    def is_in_the_midst_of_a_stage() -> bool:
        return any(
            event["event"] == "case" and event["stage"] == "spectral"
            for event in read_events(runs / NAME)
        )

    with DaskBench(tmp_path / "dask") as dask, cluster_at(dask.address, terminal) as workers:
        # The worker and its nanny, so that it does not come back.
        with dask.killed_when(dask.workers[0], is_in_the_midst_of_a_stage):
            run_study(NAME, settings, RunOptions(runs, cluster=workers), terminal)
        assert dask.workers[0].poll() is not None
    ours, theirs = (without_machine(results_in(run)) for run in (runs / NAME, tiny_run))
    assert [name for name in theirs if ours.get(name) != theirs[name]] == []
    assert ours.keys() == theirs.keys()
    assert os.environ.get("OMP_NUM_THREADS") == "1", "the bytes are compared at one thread"


def without_machine(results: dict[str, bytes]) -> dict[str, bytes]:
    """What a stage says of where it ran depends on what the process had loaded by then."""
    return {
        name: json.dumps(json.loads(content) | {"ran_on": {}}).encode()
        if name.endswith("stage.json")
        else content
        for name, content in results.items()
    }

"""`matching: none`: from masks to report by rigid alignment and adaptation, without PyTorch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd
from tiny_study import write_balls

import ssm_pipeline

CODE = """
import sys
from pathlib import Path
from tiny_study import NAME, tiny_settings
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal

masks, runs = map(Path, sys.argv[1:])
settings = tiny_settings(masks)
methods = ("without adaptation", "nearest point")
comparison = settings.comparison.model_copy(update={"methods": methods})
settings = settings.model_copy(update={"matching": "none", "comparison": comparison})
run_study(NAME, settings, RunOptions(runs), Terminal())
assert "torch" not in sys.modules
"""


def test_a_study_without_a_network_needs_no_pytorch(tmp_path: Path) -> None:
    masks = write_balls(tmp_path / "masks")
    ran = subprocess.run(
        [sys.executable, "-c", CODE, str(masks), str(tmp_path / "runs")],
        check=False,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    assert ran.returncode == 0, ran.stderr
    assert "no network" in ran.stdout
    assert "without adaptation left out" in ran.stdout
    run = ssm_pipeline.load_run(tmp_path / "runs" / "luna16")
    assert run.model.mode_count == 3
    path = run.path(run.path_cases[0])
    # X(1, 1) lies on the case: within a voxel of 2 mm.
    own = run.mesh(path.case_id).vertices
    gap = abs(path.at(1).mean(axis=0) - own.mean(axis=0)).max()
    assert gap < 2.0
    losses = pd.read_csv(run.folder / "training" / "template_losses.csv")
    assert run.template_id == losses.loc[losses["mean_loss"].idxmin(), "case_id"]
    assert (run.folder / "report" / "index.html").is_file()

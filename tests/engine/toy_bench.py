"""The toy study in a folder of its own: run it, see which cases it worked on and what it said."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from toy_study import toy_job, toy_stages

from ssm_pipeline.engine.per_case import Workers
from ssm_pipeline.engine.runner import RunOptions, run_stages
from ssm_pipeline.engine.terminal import Terminal

GOOD = {"a": "1", "b": "2", "c": "3", "d": "4"}


class Bench:
    """Runs the toy study in a folder of its own and keeps what it said."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.masks, self.diary = folder, folder / "masks", folder / "diary.txt"

    def run(
        self, name: str = "toy", jobs: int = 1, cluster: Workers | None = None, **settings: int
    ) -> str:
        self.diary.write_text("")
        out = io.StringIO()
        terminal = Terminal(Console(file=out, soft_wrap=True, markup=False, highlight=False))
        run_stages(
            toy_job(self.masks, name, **settings),
            toy_stages(self.diary),
            RunOptions(self.folder / "runs", jobs=jobs, cluster=cluster),
            terminal,
        )
        return out.getvalue()

    @property
    def worked_on(self) -> list[str]:
        return self.diary.read_text().split()

    @property
    def sum(self) -> str:
        return (self.folder / "runs" / "toy" / "sum" / "sum.txt").read_text()

    def stage_json(self, stage: str) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(
            (self.folder / "runs" / "toy" / stage / "stage.json").read_text()
        )
        return content

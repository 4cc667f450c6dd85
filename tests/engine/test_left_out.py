"""What a run says of its cases: singular and plural, and those left out once more at the end."""

from __future__ import annotations

import io

from rich.console import Console

from ssm_pipeline.engine.terminal import SHOWN_DROPPED, Terminal
from ssm_pipeline.records import Dropped


def said(count: int) -> list[str]:
    console = Console(file=io.StringIO(), width=200)
    dropped = [Dropped(f"case_{n}", "meshing", "3 boundary loops") for n in range(count)]
    Terminal(console).left_out(dropped)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_cases_left_out_are_named_with_stage_and_reason() -> None:
    assert said(1) == ["1 case was left out:", "      case_0 (meshing): 3 boundary loops"]
    assert said(2)[0] == "2 cases were left out:"


def test_many_cases_left_out_are_cut() -> None:
    lines = said(SHOWN_DROPPED + 3)
    assert len(lines) == SHOWN_DROPPED + 2
    assert lines[-1].strip() == "and 3 more; stage.json names them all"

"""What a test of the `workflow` command calls, and what it gets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Said:
    code: int
    stdout: str
    stderr: str


Workflow = Callable[..., Said]

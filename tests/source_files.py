"""The project's own source files, for tests that read the code."""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "ssm_pipeline"


def all_modules() -> list[Path]:
    """Every module of the package, those below `ssm_pipeline/data_prep` (a link) included."""
    return sorted(
        Path(folder) / name
        for folder, _, names in os.walk(PACKAGE, followlinks=True)
        for name in names
        if name.endswith(".py")
    )

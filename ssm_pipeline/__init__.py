"""From CT or MR segmentation masks to a statistical shape model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ssm_pipeline.commands.from_python import run
    from ssm_pipeline.stages.run import load_run

__all__ = ["load_run", "run"]


def __getattr__(name: str) -> Any:
    """`load_run` and `run`, imported when first asked for: importing the package stays instant."""
    if name == "load_run":
        from ssm_pipeline.stages.run import load_run

        return load_run
    if name == "run":
        from ssm_pipeline.commands.from_python import run

        return run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

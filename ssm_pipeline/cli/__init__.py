"""The `workflow` command. Heavy imports are inside the functions: `--help` is instant."""

from __future__ import annotations

import os
import sys
import traceback

import typer

# Each adds its commands; they stand in `--help` in this order.
from ssm_pipeline.cli import studies  # noqa: F401

# isort: split
from ssm_pipeline.cli import results  # noqa: F401

# isort: split
from ssm_pipeline.cli import benchmarks, care  # noqa: F401
from ssm_pipeline.cli.app import app

INTERRUPTED = 130  # the exit code of a command stopped by Ctrl-C


def main() -> None:
    """Entry point: an error is one message; its traceback is in the run's log, or asked for."""
    # OpenMP threads that wait shall sleep, not spin: beside other work on the cores, spinning
    # doubled a training step. Read when the first library loads OpenMP, so it is set before all.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    words = sys.argv[1:]
    debug = "--debug" in words
    try:
        # Not standalone: that would turn Ctrl-C into an exit of its own, and say nothing.
        code = app([word for word in words if word != "--debug"], standalone_mode=False) or 0
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED  # as later versions of Typer return of their own
    except Exception as error:
        if debug:
            traceback.print_exc()
        code = _say_error(error)
    if code == INTERRUPTED:
        typer.echo("stopped. What is finished is kept: run the same command to go on.", err=True)
    sys.exit(code)


def _say_error(error: Exception) -> int:
    """Print what went wrong and what to try.

    Returns:
        The exit code.
    """
    from ssm_pipeline.engine.per_case import CaseFailure
    from ssm_pipeline.records import CaseError, StudyError

    # A mistyped command line. Its class is click's or Typer's own copy of it, by Typer's version.
    if hasattr(error, "show") and hasattr(error, "exit_code"):
        error.show()
        return int(error.exit_code)
    message = str(error)
    if isinstance(error, CaseFailure):
        message += (
            "\nThis is a fault of the program, not of the case. What is finished is kept. Leave "
            "the case out (--set data.cases=[...]) to go on."
        )
    elif isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        message = f"{place}{error.strerror}. What is finished is kept: mend it, and run again."
    elif isinstance(error, MemoryError):
        message = "there is not enough memory. Use fewer processes (--jobs 1); finished is kept."
    elif not isinstance(error, CaseError | StudyError):
        message = f"{type(error).__name__}: {error}\nThis is a fault of the program."
    notes = [*getattr(error, "__notes__", ())]
    if not isinstance(error, CaseError | StudyError):
        notes.append("--debug shows where it happened.")
    typer.echo("\n".join([f"error: {message}", *notes]), err=True)
    return 1

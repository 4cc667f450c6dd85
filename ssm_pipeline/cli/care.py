"""Commands that look after runs and the machine: status, verify, forget, doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ssm_pipeline.cli.app import (
    RunFolder,
    RunsFolder,
    app,
    named,
)
from ssm_pipeline.counting import counted


@app.command()
def status(run_folder: RunFolder) -> None:
    """Where a run stands: stages, cases, time, memory; what runs now, and how long still."""
    from ssm_pipeline.commands.run_status import status_lines

    for line in status_lines(run_folder):
        typer.echo(line)


@app.command()
def verify(
    run_folder: RunFolder,
    remove: Annotated[
        bool, typer.Option("--remove", help="Delete what is damaged; the next run makes it again.")
    ] = False,
) -> None:
    """Is every file of a run still what was written? Reads all of them."""
    from ssm_pipeline.commands.verify_run import verify_run
    from ssm_pipeline.engine.terminal import Terminal

    if not verify_run(run_folder, Terminal(), remove):
        raise typer.Exit(1)


@app.command()
def forget(
    case_id: Annotated[str, typer.Argument(metavar="CASE", help="The case to forget.")],
    run_folder: Annotated[
        Path, typer.Option("--run", help="The run, as runs/luna16.", callback=named)
    ],
) -> None:
    """Delete every trace of a withdrawn case in a run, and all that was made with it."""
    from ssm_pipeline.commands.forget_case import forget_case

    forgotten = forget_case(case_id, run_folder)
    typer.echo(f"{counted(len(forgotten.deleted), 'file')} deleted. Later runs leave the case out.")
    for folder in forgotten.exports:
        typer.echo(f"delete by hand, or export again: {folder}")
    typer.echo("Take its file out of the data's folder too, then run again for a new model.")


@app.command()
def doctor(runs: RunsFolder = Path("runs")) -> None:
    """What this machine offers: versions, GPU, threads, disk, rendering. For bug reports."""
    from ssm_pipeline.commands.doctor import diagnosis

    lines, is_well = diagnosis(runs)
    typer.echo("\n".join(lines))
    if not is_well:
        raise typer.Exit(1)

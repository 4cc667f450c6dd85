"""The `workflow` command itself, and the arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:  # at run time inside the function: a command line imports nothing heavy
    from ssm_pipeline.engine.runner import RunOptions

app = typer.Typer(
    help="From CT or MR segmentation masks to a statistical shape model.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

StudyName = Annotated[
    str, typer.Argument(help="A study's name (see `workflow list`) or the path of its YAML.")
]
DataFolder = Annotated[
    Path | None, typer.Option("--data", help="Folder with the cases.", show_default=False)
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change a setting, as training.steps=2000. May be repeated.",
        show_default=False,
    ),
]
Device = Annotated[
    str | None, typer.Option(help="cpu or cuda; cuda where there is one.", show_default=False)
]
Jobs = Annotated[
    int | None, typer.Option(min=1, help="Cases at a time; one per core.", show_default=False)
]
Cluster = Annotated[
    str | None,
    typer.Option(
        help="Work on cases there: a Dask scheduler (tcp://host:8786), or a YAML of Slurm jobs.",
        show_default=False,
    ),
]
MemoryGB = Annotated[
    float | None,
    typer.Option("--memory-gb", help="Most that a process takes for a case.", show_default=False),
]


def named(folder: Path) -> Path:
    """The folder by its name, where it was given as `.` or `..`: a run is called as its folder.

    >>> named(Path()) == Path.cwd(), named(Path("runs/luna16"))
    (True, PosixPath('runs/luna16'))
    """
    return folder if folder.name not in ("", "..") else folder.resolve()


def run_name(study: str) -> str:
    """What the run of a study is called: its name, which may have dots, or its YAML's.

    >>> run_name("v1.2"), run_name("mine/liver.yaml")
    ('v1.2', 'liver')
    """
    return Path(study).name.removesuffix(".yaml").removesuffix(".yml")


RunFolder = Annotated[
    Path, typer.Argument(metavar="RUN", help="A run, as runs/luna16.", callback=named)
]
RunsFolder = Annotated[Path, typer.Option("--runs", help="Folder that holds the runs.")]


@app.callback()
def _options(
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; anywhere in the line.")
    ] = False,
) -> None:
    """`main` takes --debug out of the line, wherever it stands."""


def run_options(runs: Path, device: str | None, jobs: int | None, **more: Any) -> RunOptions:
    """`RunOptions`, where a command's line does not say it as this machine offers."""
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions

    return RunOptions(runs, chosen_device(device), jobs or default_jobs(), **more)

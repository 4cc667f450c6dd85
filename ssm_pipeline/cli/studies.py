"""Commands on a study: run it, check it, show its settings, write a new one, view its report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ssm_pipeline.cli.app import (
    Changes,
    Cluster,
    DataFolder,
    Device,
    Jobs,
    MemoryGB,
    RunFolder,
    RunsFolder,
    StudyName,
    app,
    run_name,
    run_options,
)


@app.command()
def run(
    study: StudyName,
    data: DataFolder = None,
    changes: Changes = None,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
    jobs: Jobs = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of every random draw.", show_default=False)
    ] = None,
    cluster: Cluster = None,
    memory_gb: MemoryGB = None,
) -> None:
    """Masks to shape model and report; goes on where an earlier run stopped."""
    from ssm_pipeline.commands.cluster import cluster_at
    from ssm_pipeline.commands.run_study import run_study
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_study
    from ssm_pipeline.training.team import team_of_torchrun

    terminal = Terminal()
    with team_of_torchrun() as team:
        if not team.leads:
            from ssm_pipeline.training.train import follow

            follow(team)
            return
        seeds = [f"seed={seed}"] if seed is not None else []
        chosen = read_study(study, data, [*(changes or []), *seeds])
        if chosen.settings.matching == "network":
            team.refuse_idle(chosen.settings.training.pairs_per_step)
        chosen.announce(terminal)
        with cluster_at(cluster, terminal, memory_gb) as workers:
            options = run_options(runs, device, jobs, cluster=workers, memory_gb=memory_gb)
            run_folder = run_study(chosen.name, chosen.settings, options, terminal)
    terminal.say(f"report: {run_folder / 'report' / 'index.html'}")


@app.command()
def check(
    study: StudyName,
    data: DataFolder = None,
    changes: Changes = None,
    to: Annotated[
        Path | None,
        typer.Option("--to", help="Folder for a table and pictures.", show_default=False),
    ] = None,
    jobs: Jobs = None,
) -> None:
    """Read the settings and every case; say what is wrong, and who is unlike the others."""
    from ssm_pipeline.commands.check import check_study
    from ssm_pipeline.engine.process import default_jobs
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_study

    chosen = read_study(study, data, changes or [])
    if not check_study(chosen, Terminal(), jobs or default_jobs(), to):
        raise typer.Exit(1)


@app.command()
def show(study: StudyName, data: DataFolder = None, changes: Changes = None) -> None:
    """Print every setting as it would be used."""
    from ssm_pipeline.study.study import read_study

    chosen = read_study(study, data, changes or [])
    typer.echo(f"# {chosen.path}")
    typer.echo(chosen.settings.to_yaml().rstrip())


@app.command(name="list")
def list_studies() -> None:
    """The studies that a name finds from here."""
    from ssm_pipeline.study.study import study_paths
    from ssm_pipeline.study.yaml_settings import read_yaml

    paths = study_paths()
    width = max((len(name) for name in paths), default=0)
    for name, path in paths.items():
        typer.echo(f"{name:<{width}}   {read_yaml(path).get('description', '')}")


@app.command()
def init(
    name: Annotated[str, typer.Argument(help="Name of the new study.")],
    masks: Annotated[
        Path | None,
        typer.Option("--masks", help="Folder with the label images.", show_default=False),
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option("--meshes", help="Folder with surfaces instead.", show_default=False),
    ] = None,
    label: Annotated[
        list[int] | None,
        typer.Option("--label", help="Label of the organ. Repeated: united.", show_default=False),
    ] = None,
    segment: Annotated[
        list[str] | None,
        typer.Option(
            "--segment",
            help="Name of the organ's segment, in .seg.nrrd and DICOM SEG. Repeated: united.",
            show_default=False,
        ),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="Of probability maps: organ is above it.", show_default=False),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Of the files' lengths: um, mm, cm or m.", show_default=False)
    ] = None,
    mirror: Annotated[
        str | None,
        typer.Option(help="left or right: that side is reflected.", show_default=False),
    ] = None,
    pattern: Annotated[
        str | None,
        typer.Option(help="Glob below the folder, as */liver.nii.gz.", show_default=False),
    ] = None,
) -> None:
    """Write the YAML of a new study on a folder of masks or surfaces, with comments."""
    from ssm_pipeline.commands.new_study import data_of, write_study

    how = {"labels": label, "segments": segment, "threshold": threshold, "unit": unit}
    data = data_of(masks, meshes, {**how, "mirror": mirror, "pattern": pattern})
    path = write_study(name, data)
    typer.echo(f"wrote {path}. Look it over, then: workflow check {path.stem}")


@app.command()
def evaluate(
    run_folder: RunFolder,
    samples: Annotated[
        int | None, typer.Option(min=2, help="Shapes drawn for specificity.", show_default=False)
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(min=0, help="Held-out folds; 0: one case at a time.", show_default=False),
    ] = None,
    retrain: Annotated[
        bool, typer.Option("--retrain", help="Train the matcher anew without each fold.")
    ] = False,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change a setting of evaluation, comparison or report, as evaluation.points=8000.",
            show_default=False,
        ),
    ] = None,
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """Score a run's model again with other evaluation settings, and renew its report."""
    from ssm_pipeline.commands.run_study import run_study
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.records import StudyError
    from ssm_pipeline.study.study import read_run_settings
    from ssm_pipeline.study.yaml_settings import changed_key

    wanted = [f"evaluation.samples={samples}"] if samples is not None else []
    wanted += [f"evaluation.folds={folds}"] if folds is not None else []
    wanted += ["comparison.retrain=true"] if retrain else []
    for change in changes or []:
        if changed_key(change).split(".")[0] not in ("evaluation", "comparison", "report"):
            raise StudyError(
                f"--set {change} changes how the model is made, and evaluate scores it as it is: "
                "evaluation, comparison and report can be changed. To make it anew: workflow run."
            )
    settings = read_run_settings(run_folder, [*(changes or []), *wanted])
    options = run_options(run_folder.parent, device, jobs)
    terminal = Terminal()
    run_study(run_folder.name, settings, options, terminal)
    terminal.say(f"tables: {run_folder / 'evaluation'}")
    terminal.say(f"report: {run_folder / 'report' / 'index.html'}")


@app.command()
def view(study: StudyName, runs: RunsFolder = Path("runs")) -> None:
    """Open a study's report in the browser."""
    import webbrowser

    from ssm_pipeline.records import StudyError

    page = runs / run_name(study) / "report" / "index.html"
    if not page.is_file():
        raise StudyError(f"there is no {page}; make it with: workflow run {study}")
    typer.echo(str(page))
    webbrowser.open(page.resolve().as_uri())

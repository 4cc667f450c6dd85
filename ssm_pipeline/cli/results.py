"""Commands on what a run left: figures and files for other programs, new patients, groups."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ssm_pipeline.cli.app import (
    Jobs,
    RunFolder,
    RunsFolder,
    StudyName,
    app,
    run_name,
)
from ssm_pipeline.counting import counted


@app.command()
def figures(
    study: StudyName,
    formats: Annotated[str, typer.Option("--format", help="pdf, png, or both.")] = "pdf,png",
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a figure's setting, as font_size_pt=7."),
    ] = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Figures for a paper: modes, interpolation, correspondence, quality curves."""
    from ssm_pipeline.commands.figures import draw_figures

    for path in draw_figures(runs / run_name(study), formats.split(","), changes or []):
        typer.echo(str(path))


@app.command()
def report(
    study: StudyName,
    pseudonymise: Annotated[
        bool, typer.Option("--pseudonymise", help="A second page with case_001 … for case ids.")
    ] = False,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Write a finished run's page again, or a page to be sent to others."""
    from ssm_pipeline.commands.report_page import write_report_page

    typer.echo(str(write_report_page(runs / run_name(study), pseudonymise)))


@app.command()
def export(
    study: StudyName,
    folder: Annotated[
        Path | None,
        typer.Option("--to", help="Where to; the run's own export folder.", show_default=False),
    ] = None,
    formats: Annotated[
        str, typer.Option("--format", help="Some of these, with commas.")
    ] = "npz,csv,glb,ply,vtp,statismo,shapeworks",
    pseudonymise: Annotated[
        bool, typer.Option("--pseudonymise", help="case_001 … in place of case ids.")
    ] = False,
    runs: RunsFolder = Path("runs"),
) -> None:
    """The model for other programs: 3D Slicer, Blender, Scalismo, ShapeWorks, spreadsheets."""
    from ssm_pipeline.commands.export_run import export_run

    for path in export_run(runs / run_name(study), folder, formats.split(","), pseudonymise):
        typer.echo(str(path))


@app.command()
def fit(
    run_folder: RunFolder,
    patients: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Masks, surfaces, or folders of new patients."),
    ],
    folder: Annotated[Path, typer.Option("--out", help="Where to.")] = Path("fits"),
    by: Annotated[
        str, typer.Option(help="model: it finds its own place; matcher: network and adaptation.")
    ] = "model",
    label: Annotated[
        list[int] | None,
        typer.Option("--label", help="Label in the masks; the study's own.", show_default=False),
    ] = None,
    segment: Annotated[
        list[str] | None,
        typer.Option("--segment", help="Its name, in .seg.nrrd and DICOM SEG.", show_default=False),
    ] = None,
    unit: Annotated[
        Literal["um", "mm", "cm", "m"] | None,
        typer.Option(help="Of the files' lengths; the study's own.", show_default=False),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="Reflect them, as data.mirror does with one side.")
    ] = False,
    jobs: Jobs = None,
) -> None:
    """Fit new patients: scores, reconstruction, what is missing, and whether to believe it."""
    from ssm_pipeline.commands.fit_patients import fit_patients
    from ssm_pipeline.engine.process import default_jobs
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.new_patient import HowToRead

    terminal = Terminal()
    how = HowToRead(tuple(label or ()), tuple(segment or ()), unit, mirror)
    fit_patients(run_folder, patients, folder, by, how, jobs or default_jobs(), terminal)
    terminal.say(f"page: {folder / 'index.html'}")


@app.command()
def compare(
    run_folder: RunFolder,
    covariates: Annotated[Path, typer.Option("--covariates", help=".tsv or .csv, a row per case.")],
    formula: Annotated[str, typer.Option("--formula", help='As "~ sex + age".')],
    folder: Annotated[
        Path | None,
        typer.Option("--out", help="Where to; the run's own compare folder.", show_default=False),
    ] = None,
    modes: Annotated[
        int | None,
        typer.Option(min=1, help="Modes tested together; 90 % of variance.", show_default=False),
    ] = None,
    permutations: Annotated[int, typer.Option(min=99, help="Of the tests.")] = 4999,
) -> None:
    """Test shape against covariates: groups, regression, maps of where, and power."""
    from ssm_pipeline.commands.compare_cases import compare_cases

    compare_cases(run_folder, covariates, formula, folder, modes, permutations)


@app.command()
def transfer(
    run_folder: RunFolder,
    landmarks: Annotated[
        Path | None,
        typer.Option(help="Slicer's .mrk.json or .fcsv, on the template.", show_default=False),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(help="CSV: vertex of the template, label.", show_default=False),
    ] = None,
    fits: Annotated[
        Path | None,
        typer.Option(help="Folder of `workflow fit`: its patients too.", show_default=False),
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Where to.")] = Path("carried"),
) -> None:
    """Landmarks and labels of the template on every case, in its scan's millimetres."""
    from ssm_pipeline.commands.transfer import transfer as carry

    written = carry(run_folder, folder, landmarks, labels, fits)
    typer.echo(f"wrote {counted(len(written), 'file')} to {folder}")


@app.command(name="import")
def import_(
    model: Annotated[Path, typer.Argument(help="A Statismo .h5 or .h5.json, or our .npz.")],
    name: Annotated[
        str | None, typer.Option(help="Of the run; the file's.", show_default=False)
    ] = None,
    label: Annotated[
        list[int] | None,
        typer.Option("--label", help="The organ's in masks to be fitted.", show_default=False),
    ] = None,
    unit: Annotated[
        Literal["um", "mm", "cm", "m"] | None,
        typer.Option(help="Of the model's lengths; mm.", show_default=False),
    ] = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Another program's model as a run that view, fit and export accept."""
    from ssm_pipeline.commands.import_model import import_model

    typer.echo(str(import_model(model, name, runs, tuple(label or ()), unit)))

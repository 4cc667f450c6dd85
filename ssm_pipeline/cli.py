"""The `workflow` command. Heavy imports are inside the functions: `--help` is instant."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

INTERRUPTED = 130  # the exit code of a command stopped by Ctrl-C

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
    Path | None, typer.Option("--data", help="Folder with the masks.", show_default=False)
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
    int | None, typer.Option(min=1, help="Cases at a time; one a core.", show_default=False)
]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run, as runs/luna16.")]
RunsFolder = Annotated[Path, typer.Option("--runs", help="Folder that holds the runs.")]


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
) -> None:
    """Masks to shape model and report; goes on where an earlier run stopped."""
    from ssm_pipeline.commands.run_study import run_study
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_study

    seeds = [f"seed={seed}"] if seed is not None else []
    chosen = read_study(study, data, [*(changes or []), *seeds])
    terminal = Terminal()
    chosen.announce(terminal)
    options = RunOptions(runs, chosen_device(device), jobs or default_jobs())
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
        str | None, typer.Option(help="Of the surfaces: mm, cm or m.", show_default=False)
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
    typer.echo(f"wrote {path}. Look it over, then: workflow check {name}")


benchmark = typer.Typer(help="Measure the method where the truth is known.", no_args_is_help=True)
app.add_typer(benchmark, name="benchmark")


@benchmark.command()
def phantoms(
    changes: Changes = None,
    reported: Annotated[
        bool, typer.Option("--reported", help="The cohorts that are published, not development's.")
    ] = False,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """The whole pipeline on synthetic organs with known truth, as scanned and turned."""
    from data_prep.phantom_seeds import DEVELOPMENT, REPORTED
    from ssm_pipeline.commands.phantom_benchmark import run_phantom_benchmark
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_study

    chosen = read_study("phantoms", None, changes or [])
    options = RunOptions(runs, chosen_device(device), jobs or default_jobs())
    terminal = Terminal()
    seeds = REPORTED if reported else DEVELOPMENT
    methods, modes = run_phantom_benchmark(chosen.settings, options, terminal, seeds)
    for table in (methods, modes):
        terminal.say(table.round(3).to_string(index=False))
    terminal.say(f"tables: {runs / 'phantom-benchmark.csv'}, {runs / 'phantom-modes.csv'}")


@benchmark.command()
def results(
    data: Annotated[
        list[str] | None,
        typer.Option(
            "--data", help="lungs=FOLDER or hippocampi=FOLDER. Repeated.", show_default=False
        ),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="A part alone, as lungs. Repeated.", show_default=False)
    ] = None,
    folder: Annotated[Path, typer.Option("--to", help="Where to.")] = Path("docs/results"),
    changes: Changes = None,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """Every number of the results page, with seed, commit, machine and minutes; part by part."""
    from ssm_pipeline.commands.results import make_results
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.records import StudyError

    folders: dict[str, Path] = {}
    for word in data or []:
        name, equals, place = word.partition("=")
        if not equals:
            raise StudyError(f"--data {word}: a name and a folder are needed, as lungs=FOLDER.")
        folders[name] = Path(place)
    options = RunOptions(runs, chosen_device(device), jobs or default_jobs())
    terminal = Terminal()
    made = make_results(folder, folders, options, terminal, only or [], changes or [])
    terminal.say(f"{', '.join(made) or 'nothing'}: {folder / 'results.json'}")


@benchmark.command()
def spread(
    study: StudyName,
    data: DataFolder = None,
    changes: Changes = None,
    templates: Annotated[int, typer.Option(min=1, help="Templates, the best first.")] = 3,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds, from the study's own on.")] = 3,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """A study repeated with other seeds and other templates: how much its results vary."""
    from ssm_pipeline.commands.spread import run_spread
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_study

    chosen = read_study(study, data, changes or [])
    options = RunOptions(runs / "spread", chosen_device(device), jobs or default_jobs())
    terminal, first = Terminal(), chosen.settings.seed
    wanted = range(first, first + seeds)
    _, each, mean = run_spread(chosen.name, chosen.settings, options, terminal, wanted, templates)
    path = runs / "spread" / f"{chosen.name}-spread.csv"
    each.to_csv(path.with_name(f"{chosen.name}-spread-runs.csv"), index=False)
    mean.to_csv(path, index=False)
    terminal.say(mean.round(3).to_string(index=False))
    terminal.say(f"table: {path}")


@benchmark.command()
def s3m(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run, as runs/luna16.")],
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """Scores of S3M after 1, 3, 10 and 30 epochs of a run's one training, and its losses."""
    from ssm_pipeline.commands.s3m_epochs import score_s3m_epochs
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.terminal import Terminal

    terminal = Terminal()
    table = score_s3m_epochs(
        run_folder, terminal, device=chosen_device(device), jobs=jobs or default_jobs()
    )
    terminal.say(table.round(3).to_string(index=False))
    terminal.say(f"tables: {run_folder / 'evaluation' / 'S3M'}")


@benchmark.command()
def matching(
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder with off/ and corres/.", show_default=False),
    ] = None,
    built_in: Annotated[
        str | None,
        typer.Option(
            "--built-in", help="articulated or articulated-shapes: figures made here.",
            show_default=False,
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="faust, scape, shrec19, topkids, smal, dt4d-intra, dt4d-inter, or a YAML.",
            show_default=False,
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(help="Rows, with commas: full, adaptation only …", show_default=False),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Training steps, fewer for a look.")
    ] = None,
    train: Annotated[
        str | None, typer.Option(help="Shapes to train on: 0:80, train.txt, or dog,fox.")
    ] = None,
    test: Annotated[str | None, typer.Option(help="Shapes to test on, likewise.")] = None,
    self_pairs: Annotated[
        bool, typer.Option("--self-pairs", help="Count a shape's map to itself too.")
    ] = False,
    checkpoint: Annotated[
        Path | None, typer.Option(help="A trained matcher.pt, instead of training.")
    ] = None,
    changes: Changes = None,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
) -> None:
    """Mean geodesic error on shapes with known correspondences, as the papers report it."""
    from ssm_pipeline.commands.benchmark_shapes import benchmark_shapes, built_in_shapes
    from ssm_pipeline.commands.matching_benchmark import run_matching
    from ssm_pipeline.commands.matching_benchmark_settings import read_benchmark_settings
    from ssm_pipeline.engine.process import chosen_device
    from ssm_pipeline.engine.terminal import Terminal

    settings = read_benchmark_settings(
        data, built_in, preset, methods, steps, train, test, self_pairs, changes or []
    )
    terminal = Terminal()
    name = built_in or str(data and data.resolve().name)
    folder = runs / f"matching-{name}"
    shapes = (
        benchmark_shapes(name, data, settings)
        if data is not None
        else built_in_shapes(name, folder / "shapes", settings, terminal)
    )
    summary = run_matching(shapes, folder, settings, checkpoint, chosen_device(device), terminal)
    terminal.say(summary.round(3).to_string(index=False))
    terminal.say(f"tables and curves: {folder}")


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
    changes: Changes = None,
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """Score a run's model again with other evaluation settings, and renew its report."""
    from ssm_pipeline.commands.run_study import run_study
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.runner import RunOptions
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.study.study import read_run_settings

    wanted = [f"evaluation.samples={samples}"] if samples is not None else []
    wanted += [f"evaluation.folds={folds}"] if folds is not None else []
    wanted += ["comparison.retrain=true"] if retrain else []
    settings = read_run_settings(run_folder, [*(changes or []), *wanted])
    options = RunOptions(run_folder.parent, chosen_device(device), jobs or default_jobs())
    terminal = Terminal()
    run_study(run_folder.name, settings, options, terminal)
    terminal.say(f"tables: {run_folder / 'evaluation'}")
    terminal.say(f"report: {run_folder / 'report' / 'index.html'}")


@app.command()
def view(study: StudyName, runs: RunsFolder = Path("runs")) -> None:
    """Open a study's report in the browser."""
    import webbrowser

    from ssm_pipeline.records import StudyError

    page = runs / Path(study).stem / "report" / "index.html"
    if not page.is_file():
        raise StudyError(f"there is no {page}; make it with: workflow run {study}")
    typer.echo(str(page))
    webbrowser.open(page.resolve().as_uri())


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

    for path in draw_figures(runs / Path(study).stem, formats.split(","), changes or []):
        typer.echo(str(path))


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

    for path in export_run(runs / Path(study).stem, folder, formats.split(","), pseudonymise):
        typer.echo(str(path))


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
    run_folder: Annotated[Path, typer.Option("--run", help="The run, as runs/luna16.")],
) -> None:
    """Delete every trace of a withdrawn case in a run, and all that was made with it."""
    from ssm_pipeline.commands.forget_case import forget_case

    forgotten = forget_case(case_id, run_folder)
    typer.echo(f"{len(forgotten.deleted)} files deleted. Later runs leave the case out.")
    for folder in forgotten.exports:
        typer.echo(f"delete by hand, or export again: {folder}")
    typer.echo("Take the mask out of its folder too, then run the study again for a new model.")


@app.command()
def doctor(runs: RunsFolder = Path("runs")) -> None:
    """What this machine offers: versions, GPU, threads, disk, rendering. For bug reports."""
    from ssm_pipeline.commands.doctor import diagnosis

    lines, is_well = diagnosis(runs)
    typer.echo("\n".join(lines))
    if not is_well:
        raise typer.Exit(1)


@app.callback()
def _options(
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; anywhere in the line.")
    ] = False,
) -> None:
    """`main` takes --debug out of the line, wherever it stands."""


@app.command()
def fit(
    run_folder: RunFolder,
    patients: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Masks or surfaces of new patients.")
    ],
    folder: Annotated[Path, typer.Option("--out", help="Where to.")] = Path("fits"),
    by: Annotated[
        str, typer.Option(help="model: it finds its own place; matcher: network and adaptation.")
    ] = "model",
    label: Annotated[
        list[int] | None,
        typer.Option("--label", help="Label in the masks; the study's own.", show_default=False),
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

    terminal = Terminal()
    jobs = jobs or default_jobs()
    fit_patients(run_folder, patients, folder, by, tuple(label or ()), mirror, jobs, terminal)
    terminal.say(f"page: {folder / 'index.html'}")


@app.command()
def compare(
    run_folder: RunFolder,
    covariates: Annotated[Path, typer.Option("--covariates", help="A .tsv or .csv, a row a case.")],
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
        typer.Option(help="Slicer's .mrk.json, on the template.", show_default=False),
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
    typer.echo(f"wrote {len(written)} files to {folder}")


@app.command(name="import")
def import_(
    model: Annotated[Path, typer.Argument(help="A Statismo .h5, or an .npz of ours.")],
    name: Annotated[
        str | None, typer.Option(help="Of the run; the file's.", show_default=False)
    ] = None,
    label: Annotated[
        list[int] | None,
        typer.Option("--label", help="The organ's in masks to be fitted.", show_default=False),
    ] = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Another program's model as a run that view, fit and export accept."""
    from ssm_pipeline.commands.import_model import import_model

    typer.echo(str(import_model(model, name, runs, tuple(label or ()))))


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
    """Print what went wrong and what to try. Returns the exit code."""
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


if __name__ == "__main__":
    main()

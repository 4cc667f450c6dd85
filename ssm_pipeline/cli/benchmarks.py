"""Commands that measure the method where the truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ssm_pipeline.cli.app import (
    Changes,
    DataFolder,
    Device,
    Jobs,
    RunsFolder,
    StudyName,
    app,
    run_options,
)

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
    from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT, REPORTED
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.phantom_benchmark import run_phantom_benchmark
    from ssm_pipeline.study.study import read_study

    chosen = read_study("phantoms", None, changes or [])
    options = run_options(runs, device, jobs)
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
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.results import make_results
    from ssm_pipeline.records import StudyError

    folders: dict[str, Path] = {}
    for word in data or []:
        name, equals, place = word.partition("=")
        if not equals:
            raise StudyError(f"--data {word}: a name and a folder are needed, as lungs=FOLDER.")
        folders[name] = Path(place)
    options = run_options(runs, device, jobs)
    terminal = Terminal()
    made = make_results(folder, folders, options, terminal, only or [], changes or [])
    terminal.say(f"{', '.join(made) or 'nothing'}: {folder / 'results.json'}")


@benchmark.command()
def training(
    study: StudyName,
    data: DataFolder = None,
    changes: Changes = None,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """What training brings a study: few and many steps, from built-in and from fresh weights."""
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.training_curve import run_training_curve
    from ssm_pipeline.study.study import read_study

    chosen = read_study(study, data, changes or [])
    options = run_options(runs, device, jobs)
    terminal = Terminal()
    _, table = run_training_curve(chosen.name, chosen.settings, options, terminal)
    terminal.say(table.round(3).to_string(index=False))
    terminal.say(f"table: {runs / f'{chosen.name}-training.csv'}")


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
    from ssm_pipeline import storage
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.spread import run_spread
    from ssm_pipeline.study.study import read_study

    chosen = read_study(study, data, changes or [])
    options = run_options(runs / "spread", device, jobs)
    terminal, first = Terminal(), chosen.settings.seed
    wanted = range(first, first + seeds)
    _, each, mean = run_spread(chosen.name, chosen.settings, options, terminal, wanted, templates)
    path = runs / "spread" / f"{chosen.name}-spread.csv"
    storage.write_table(each, path.with_name(f"{chosen.name}-spread-runs.csv"))
    storage.write_table(mean, path)
    terminal.say(mean.round(3).to_string(index=False))
    terminal.say(f"table: {path}")


@benchmark.command()
def s3m(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run, as runs/luna16.")],
    device: Device = None,
    jobs: Jobs = None,
) -> None:
    """Scores of S3M after 1, 3, 10 and 30 epochs of a run's one training, and its losses."""
    from ssm_pipeline.engine.process import chosen_device, default_jobs
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.s3m_epochs import score_s3m_epochs

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
            "--built-in",
            help="articulated, articulated-shapes or articulated-merged: figures made here.",
            show_default=False,
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="faust, scape, shrec19, topkids, smal, dt4d-intra, dt4d-inter, near-isometric, "
            "non-isometric, articulated, articulated-shapes, articulated-merged, or a YAML. "
            "Default: non-isometric, or that of the built-in shapes.",
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
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Compute everything again; reuse nothing.")
    ] = False,
    changes: Changes = None,
    runs: RunsFolder = Path("runs"),
    device: Device = None,
) -> None:
    """Mean geodesic error on shapes with known correspondences, as the papers report it."""
    from ssm_pipeline.engine.process import chosen_device
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.benchmark_shapes import benchmark_shapes, built_in_shapes
    from ssm_pipeline.experiments.matching_benchmark import run_matching
    from ssm_pipeline.experiments.matching_benchmark_settings import (
        changes_from_preset,
        folder_of_benchmark,
        preset_for,
        read_preset,
    )

    given = {
        "methods": [name.strip() for name in methods.split(",")] if methods else None,
        "training": {"steps": steps} if steps else None,
        "train": train,
        "test": test,
        "self_pairs": self_pairs or None,
    }
    chosen = preset_for(data, built_in, preset)
    settings = read_preset(chosen, changes or [], given)
    terminal = Terminal()
    terminal.say(f"preset {chosen}")
    name = built_in or str(data and data.resolve().name)
    folder = runs / folder_of_benchmark(name, preset)
    shapes = (
        benchmark_shapes(name, data, settings)
        if data is not None
        else built_in_shapes(name, folder / "shapes", settings, terminal)
    )
    summary = run_matching(
        shapes,
        folder,
        settings,
        checkpoint,
        chosen_device(device),
        terminal,
        preset=chosen,
        changes=changes_from_preset(chosen, settings),
        fresh=fresh,
    )
    shown = summary.drop(columns=["row", "seed", "preset", "changes"])
    terminal.say(shown.round(3).to_string(index=False))
    if summary["changes"].iloc[0]:
        terminal.say(f"changed from the preset: {summary['changes'].iloc[0]}")
    terminal.say(f"tables and curves: {folder}")


@app.command()
def pretrain(
    to: Annotated[Path, typer.Option("--to", help="The file to write.")] = Path("matcher.pt"),
    coordinates: Annotated[
        bool,
        typer.Option(help="The network reads them beside the wave kernel signature."),
    ] = True,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = 4500,
    device: Device = None,
) -> None:
    """Weights to start training from, of synthetic shapes alone: the built-in ones, made again."""
    from ssm_pipeline.engine.process import chosen_device
    from ssm_pipeline.engine.terminal import Terminal
    from ssm_pipeline.experiments.pretrain import pretrain as train_on_synthetic_shapes

    features: Literal["wks", "xyz+wks"] = "xyz+wks" if coordinates else "wks"
    train_on_synthetic_shapes(features, steps, to, chosen_device(device), Terminal())

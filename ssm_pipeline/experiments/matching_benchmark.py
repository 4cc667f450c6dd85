"""`workflow benchmark matching`: train on some shapes, test on others, a row per method."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.process import keep_large_blocks
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.benchmark_files import BenchmarkFiles, key_of_mesh
from ssm_pipeline.experiments.benchmark_shapes import BenchmarkShapes
from ssm_pipeline.experiments.matching_benchmark_settings import MatchingBenchmarkSettings
from ssm_pipeline.experiments.matching_cost import cost_in_words, seconds_a_pair, seconds_a_step
from ssm_pipeline.methods import FULL, method_named
from ssm_pipeline.records import Mesh, ShapePath, StudyError
from ssm_pipeline.runs.resumable_training import TrainingJob, key_of_start, trained_matcher
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:
    from ssm_pipeline.evaluation.matching_benchmark import MatchingBenchmark


def run_matching(
    shapes: BenchmarkShapes,
    folder: Path,
    settings: MatchingBenchmarkSettings,
    checkpoint: Path | None,
    device: str,
    terminal: Terminal,
) -> pd.DataFrame:
    """summary.csv (rows as in the papers' tables), pairs.csv, pck.csv and pck.png in `folder`;
    with a row `full` also interpolation.csv and interpolation_curve.csv of a few pairs.

    checkpoint  a trained matcher (matcher.pt) to test instead of training one; the row "spectral
                only" has a network of its own all the same.
    Spectral bases, trained matchers, geodesic distances and maps are kept in `folder`. Where test
    shapes were trained on, the row's name says so.
    """
    from ssm_pipeline.evaluation.interpolation_quality import interpolation_tables

    keep_large_blocks()
    _say_what_is_odd(shapes, terminal)
    files = BenchmarkFiles(folder, settings.spectral)
    _say_cost(shapes, files, settings, checkpoint, device, terminal)
    results: list[MatchingBenchmark] = []
    paths: list[ShapePath] = []
    for method in settings.methods:
        predictor = _Predictor(shapes, files, settings, method, checkpoint, device, terminal)
        results.append(_row(shapes, files, predictor, terminal))
        if method == FULL:
            paths = _paths(predictor, settings.interpolations, terminal)
    tables = {
        "summary": pd.concat([result.summary for result in results], ignore_index=True),
        "pairs": pd.concat([result.pairs for result in results], ignore_index=True),
        "pck": pd.concat([result.curve for result in results], ignore_index=True),
    } | interpolation_tables(paths)
    for name, table in tables.items():
        storage.write_table(table, folder / f"{name}.csv")
    _say_interpolation(tables, terminal)
    _draw_curves(tables["pck"], tables["summary"], folder / "pck.png")
    return tables["summary"]


def _row(
    shapes: BenchmarkShapes, files: BenchmarkFiles, predictor: _Predictor, terminal: Terminal
) -> MatchingBenchmark:
    from ssm_pipeline.evaluation.matching_benchmark import run_matching_benchmark

    with terminal.steps(predictor.method, len(shapes.pairs)) as steps:
        return run_matching_benchmark(
            shapes.meshes,
            shapes.pairs,
            predictor.predict,
            files.geodesics,
            shapes.name,
            predictor.method + predictor.seen(),
            on_pair=lambda done, of: steps.advance_to(done),
        )


def _paths(predictor: _Predictor, count: int, terminal: Terminal) -> list[ShapePath]:
    """The interpolations of some pairs, evenly over all."""
    known = predictor.shapes.pairs
    count = min(count, len(known))
    found = []
    with terminal.steps("interpolations", count) as steps:
        for number in range(count):
            pair = known[number * len(known) // count]
            found.append(predictor.path(*(predictor.shapes.meshes[i] for i in (pair.x, pair.y))))
            steps.advance_to(number + 1)
    return found


class _Predictor:
    """One method's maps: from its network, trained when first needed, or from the folder."""

    def __init__(
        self,
        shapes: BenchmarkShapes,
        files: BenchmarkFiles,
        settings: MatchingBenchmarkSettings,
        method: str,
        checkpoint: Path | None,
        device: str,
        terminal: Terminal,
    ) -> None:
        from ssm_pipeline.training.matcher import load_matcher

        self.shapes, self.files, self.settings, self.method = shapes, files, settings, method
        self.matcher, rests_on = None, ""
        if method_named(method).uses_network:
            path = matcher_path(shapes, files, settings, method, checkpoint)
            if path != checkpoint:
                training = training_of(settings, method)
                label = "training" + " on the spectral loss alone" * _has_own_network(method)
                key = path.stem.removeprefix("matcher-")
                trained_matcher(
                    lambda: [
                        files.training_basis(shapes.meshes[index], training.faces)
                        for index in shapes.train
                    ],
                    TrainingJob(
                        training, settings.seed, device, files.folder, key, label, terminal
                    ),
                )
            self.matcher, rests_on = load_matcher(path, device), key_of_files([path])
        self.key = key_of(method, settings.spectral, settings.adaptation, settings.seed, rests_on)

    def predict(self, x: Mesh, y: Mesh) -> np.ndarray:
        return self.files.map(x, y, self.key, lambda: self._matched(x, y))

    def path(self, x: Mesh, y: Mesh) -> ShapePath:
        """X(t, t_s) from y to x."""
        from ssm_pipeline.adaptation.path import shape_path

        matcher, seed, settings = self.matcher, self.settings.seed, self.settings.adaptation
        if matcher is None:
            raise ValueError(f"the method {self.method!r} has no network, and so no path")
        bases = self.files.basis(y), self.files.basis(x)
        return self.files.path(
            x, y, self.key, lambda: shape_path(*bases, matcher, settings, seed=seed)
        )

    def seen(self) -> str:
        """` (trained on 3 of the test shapes)`, or nothing."""
        if self.matcher is None:
            return ""
        tested = {self.shapes.meshes[index].case_id for index in self.shapes.test}
        overlap = tested & set(self.matcher.trained_on)
        return f" (trained on {len(overlap)} of the test shapes)" if overlap else ""

    def _matched(self, x: Mesh, y: Mesh) -> np.ndarray:
        from ssm_pipeline.adaptation.correspond import correspond_bases

        bases, coarse = (self.files.basis(y), self.files.basis(x)), None
        if self.matcher is not None:
            faces = self.settings.training.faces
            coarse = self.files.training_basis(y, faces), self.files.training_basis(x, faces)
        seed, adaptation = self.settings.seed, self.settings.adaptation
        match = correspond_bases(*bases, self.matcher, adaptation, self.method, coarse, seed)
        return match.nearest_vertex


def _has_own_network(method: str) -> bool:
    """Whether a network is trained for this method alone, on the spectral loss."""
    return method_named(method).network == "spectral loss"


def training_of(settings: MatchingBenchmarkSettings, method: str) -> TrainingSettings:
    return settings.training.spectral_only() if _has_own_network(method) else settings.training


def matcher_path(
    shapes: BenchmarkShapes,
    files: BenchmarkFiles,
    settings: MatchingBenchmarkSettings,
    method: str,
    checkpoint: Path | None,
) -> Path:
    """Where a method's matcher lies, or will lie once trained."""
    if checkpoint is not None and not _has_own_network(method):
        return checkpoint
    meshes = [key_of_mesh(shapes.meshes[index]) for index in shapes.train]
    training = training_of(settings, method)
    start = key_of_start(training)
    key = key_of(meshes, settings.spectral, training, start, settings.seed)
    return files.folder / f"matcher-{key}.pt"


def _say_cost(
    shapes: BenchmarkShapes,
    files: BenchmarkFiles,
    settings: MatchingBenchmarkSettings,
    checkpoint: Path | None,
    device: str,
    terminal: Terminal,
) -> None:
    """Nothing where all matchers are trained: what is left is a matter of pairs."""
    networks = [method for method in settings.methods if method_named(method).uses_network]
    paths = {matcher_path(shapes, files, settings, method, checkpoint) for method in networks}
    missing = [path for path in paths if not path.exists()]
    if checkpoint in missing:
        raise StudyError(f"--checkpoint {checkpoint}: there is no such file.")
    if not missing:
        return
    if len(shapes.train) < 2:
        raise StudyError(
            f"training needs at least 2 shapes; --train leaves {len(shapes.train)}. Give more, or "
            "a trained matcher by --checkpoint."
        )
    terminal.say("measuring a few steps and one pair …")
    meshes, faces = [shapes.meshes[index] for index in shapes.train[:2]], settings.training.faces
    coarse_x, coarse_y = (files.training_basis(mesh, faces) for mesh in meshes)
    step_s, trial = seconds_a_step(coarse_x, coarse_y, settings.training, device)
    x, y = (files.basis(mesh) for mesh in meshes)
    pair_s = seconds_a_pair(x, y, trial, settings.adaptation, settings.methods)
    pairs: dict[str, int] = {method: len(shapes.pairs) for method in settings.methods}
    terminal.say(cost_in_words(len(missing), settings.training.steps, step_s, pairs, pair_s))


def _say_interpolation(tables: dict[str, pd.DataFrame], terminal: Terminal) -> None:
    if "interpolation" not in tables:
        return
    means = tables["interpolation"].query("0 < t < 1").mean(numeric_only=True)
    terminal.say(
        "between the ends of interpolations: conformal distortion "
        f"{means.conformal_distortion:.2f}, edges change by {means.edge_change_percent:.1f} %; on "
        f"straight lines {means.straight_conformal_distortion:.2f} and "
        f"{means.straight_edge_change_percent:.1f} %"
    )


def _say_what_is_odd(shapes: BenchmarkShapes, terminal: Terminal) -> None:
    from ssm_pipeline.geometry.geodesics import bridges

    for index in shapes.test:
        mesh = shapes.meshes[index]
        apart = len(bridges(mesh.vertices, mesh.faces))
        if apart:
            terminal.say(
                f"{mesh.case_id} has {apart} pieces or single vertices apart from its largest "
                "piece; distances to them go straight across the gap"
            )


def _draw_curves(curves: pd.DataFrame, summary: pd.DataFrame, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.5), layout="constrained")
    axes = figure.add_subplot()
    for row in summary.itertuples():
        curve = curves[curves["method"] == row.method]
        label = f"{row.method}: {row.mean_geodesic_error_x100:.2f}, AUC {row.auc:.3f}"
        axes.plot(curve["threshold"], 100 * curve["share"], label=label)
    first = summary.iloc[0]
    axes.set(
        xlabel="geodesic error / √area",
        ylabel="correct points (%)",
        title=f"{first.benchmark}, {first.pairs} pairs",
        ylim=(0, 101),
    )
    axes.legend(fontsize="small")
    with storage.written_whole(path) as temporary:
        figure.savefig(temporary, dpi=200)

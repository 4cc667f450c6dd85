"""`workflow benchmark matching`: train on some shapes, test on others, a row per method."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.code_digest import code_digest
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.process import keep_large_blocks
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.benchmark_files import (
    BASIS_CODE,
    COARSE_CODE,
    BenchmarkFiles,
    dates_of,
    key_of_mesh,
)
from ssm_pipeline.experiments.benchmark_rows import BenchmarkRow, all_rows, keep_row
from ssm_pipeline.experiments.benchmark_shapes import BenchmarkShapes
from ssm_pipeline.experiments.matching_benchmark_settings import MatchingBenchmarkSettings
from ssm_pipeline.experiments.matching_cost import cost_in_words, seconds_a_pair, seconds_a_step
from ssm_pipeline.methods import FULL, method_named
from ssm_pipeline.records import Mesh, ShapePath, StudyError
from ssm_pipeline.runs.resumable_training import TrainingJob, key_of_start, trained_matcher
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:
    from ssm_pipeline.evaluation.matching_benchmark import MatchingBenchmark


MAP_CODE = "ssm_pipeline.adaptation.correspond"
PATH_CODE = "ssm_pipeline.adaptation.path"
TRAINING_CODE = "ssm_pipeline.training.train"


def run_matching(
    shapes: BenchmarkShapes,
    folder: Path,
    settings: MatchingBenchmarkSettings,
    checkpoint: Path | None,
    device: str,
    terminal: Terminal,
    preset: str = "",
    changes: str = "",
    fresh: bool = False,
) -> pd.DataFrame:
    """Score each method of the settings on the shapes.

    The rows of earlier calls in the same folder stay: `summary.csv`, `pairs.csv`, `pck.csv` and
    `pck.png` hold all of them, and `rows/` has a folder for each (`benchmark_rows`). The row `full`
    also writes interpolation.csv and interpolation_curve.csv of a few pairs.

    Args:
        shapes: What is trained on and tested.
        folder: Where results, matchers, spectral bases, geodesic distances and maps are kept.
        checkpoint: A trained matcher to test instead of training one. The row "spectral only"
            trains a network of its own all the same.
        preset: The preset that the settings come from. changes: How they differ from it.
        fresh: Whether to compute everything again instead of reusing earlier results.

    Returns:
        The rows of this call, one per method. If a matcher was trained on test shapes, the name of
        its row says so.
    """
    from ssm_pipeline.evaluation.interpolation_quality import interpolation_tables

    keep_large_blocks()
    _say_what_is_odd(shapes, terminal)
    files = BenchmarkFiles(folder, settings.spectral)
    if fresh:
        files.forget()
    _say_cost(shapes, files, settings, checkpoint, device, terminal)
    summaries: list[pd.DataFrame] = []
    for method in settings.methods:
        predictor = _Predictor(shapes, files, settings, method, checkpoint, device, terminal)
        scored = _row(shapes, files, predictor, terminal)
        row = BenchmarkRow(
            scored, method, settings, preset, changes, predictor.digest, predictor.losses
        )
        summaries.append(keep_row(folder, row))
        if method == FULL:
            tables = interpolation_tables(_paths(predictor, settings.interpolations, terminal))
            for name, table in tables.items():
                storage.write_table(table, folder / f"{name}.csv")
            _say_interpolation(tables, terminal)
    kept = all_rows(folder)
    for name, table in kept.items():
        storage.write_table(table, folder / f"{name}.csv")
    _draw_curves(kept["pck"], kept["summary"], folder / "pck.png")
    return pd.concat(summaries, ignore_index=True)


def _row(
    shapes: BenchmarkShapes, files: BenchmarkFiles, predictor: _Predictor, terminal: Terminal
) -> MatchingBenchmark:
    from ssm_pipeline.evaluation.matching_benchmark import run_matching_benchmark

    predictor.report_reuse(terminal)
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
        self.matcher, self.digest = None, ""
        self.losses: pd.DataFrame | None = None
        code = code_digest(MAP_CODE, PATH_CODE, BASIS_CODE, COARSE_CODE)
        if method_named(method).uses_network:
            path = matcher_path(shapes, files, settings, method, checkpoint)
            if path != checkpoint:
                self._train(path, device, terminal)
                self.losses = storage.read_table(path.with_name("losses.csv"))
            self.matcher, self.digest = load_matcher(path, device), key_of_files([path])
        self.key = key_of(
            method, settings.spectral, settings.adaptation, settings.seed, self.digest, code
        )

    def _train(self, path: Path, device: str, terminal: Terminal) -> None:
        """Train the matcher that belongs at `path`, unless it is there."""
        training = training_of(self.settings, self.method)
        if path.exists():
            terminal.say(f"matcher of {dates_of([path])} reused; --fresh trains again")
            return
        label = "training" + " on the spectral loss alone" * (training != self.settings.training)
        key = path.stem.removeprefix("matcher-")
        trained_matcher(
            lambda: [
                self.files.training_basis(self.shapes.meshes[index], training.faces)
                for index in self.shapes.train
            ],
            TrainingJob(training, self.settings.seed, device, path.parent, key, label, terminal),
        )

    def report_reuse(self, terminal: Terminal) -> None:
        """Say how many maps of earlier calls are reused, and from which day they are."""
        meshes = self.shapes.meshes
        paths = [
            self.files.map_path(meshes[pair.x], meshes[pair.y], self.key)
            for pair in self.shapes.pairs
        ]
        kept = [path for path in paths if path.exists()]
        if kept:
            terminal.say(
                f"{self.method}: {len(kept)} of {len(paths)} maps of {dates_of(kept)} reused; "
                "--fresh computes them again"
            )

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
    code = code_digest(TRAINING_CODE, BASIS_CODE, COARSE_CODE)
    key = key_of(meshes, settings.spectral, training, start, settings.seed, code)
    return files.folder / "matchers" / key / f"matcher-{key}.pt"


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
    several = summary["method"].value_counts()
    for row in summary.itertuples():
        curve = curves[curves["row"] == row.row]
        # A row's name ends in the hash that tells rows of one method apart.
        name = row.row if several[row.method] > 1 else row.method
        label = f"{name}: {row.mean_geodesic_error_x100:.2f}, AUC {row.auc:.3f}"
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

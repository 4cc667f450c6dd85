"""The shapes of a matching benchmark: read from a published data set, or generated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.data_prep.matching_sets.matching_folder import (
    read_matching_folder,
    write_matching_folder,
)
from ssm_pipeline.data_prep.matching_sets.matching_set import ShapesWithTruth
from ssm_pipeline.data_prep.matching_sets.shape_choice import chosen_shapes
from ssm_pipeline.data_prep.synthetic.articulated_settings import ArticulatedSettings
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.matching_benchmark_settings import MatchingBenchmarkSettings
from ssm_pipeline.records import KnownPair, Mesh

_GENERATOR_VERSION = 1  # raise it when the same settings give other figures


@dataclass(frozen=True, eq=False)
class BenchmarkShapes:
    """The shapes of a benchmark.

    Attributes:
        meshes: All of the set.
        train: Indices of the shapes that are trained on.
        test: Indices of the shapes that are matched.
        pairs: The tested pairs, with their known correspondences.
    """

    name: str
    meshes: tuple[Mesh, ...]
    train: tuple[int, ...]
    test: tuple[int, ...]
    pairs: tuple[KnownPair, ...]


def benchmark_shapes(name: str, data: Path, settings: MatchingBenchmarkSettings) -> BenchmarkShapes:
    """Read a folder in any of the known layouts. Raises StudyError, CaseError."""
    shapes = read_matching_folder(data, settings.between)
    return _chosen(name, shapes, data, settings.train, settings.test, settings)


def built_in_shapes(
    name: str, folder: Path, settings: MatchingBenchmarkSettings, terminal: Terminal
) -> BenchmarkShapes:
    """Articulated figures, written to `folder` in the literature's layout and read from there."""
    figures = settings.built_in
    stated = {
        "generator_version": _GENERATOR_VERSION,
        "settings": figures.model_dump(mode="json"),
    }
    marker = folder / "figures.json"
    if not marker.is_file() or storage.read_json(marker) != stated:
        marker.unlink(missing_ok=True)  # first, so that an incomplete folder is never used
        for path in (*folder.glob("off/*.off"), *folder.glob("corres/*.vts")):
            path.unlink()
        count = figures.training_shapes + figures.test_shapes
        with terminal.steps("figures", count) as steps:
            for index in range(count):
                _write_figure(folder, figures, index)
                steps.advance_to(index + 1)
        storage.write_json(marker, stated)
    shapes = read_matching_folder(folder)
    train, test = settings.train or _as_text(figures.training_range), settings.test
    if figures.family == "merged limbs" and not test:  # all onto the first shape
        test = ",".join(shapes.meshes[index].case_id for index in (0, *figures.test_range))
    return _chosen(name, shapes, folder, train, test or _as_text(figures.test_range), settings)


def _write_figure(folder: Path, figures: ArticulatedSettings, index: int) -> None:
    if figures.family == "merged limbs":
        from ssm_pipeline.data_prep.synthetic import articulated_merged as merged

        if index == 0:
            write_matching_folder(folder, [merged.reference(figures.vertices)])
        else:
            figure = merged.merged_figure(figures, index)
            write_matching_folder(folder, [figure.mesh], [figure.to_reference], onto_the_first=True)
        return
    from ssm_pipeline.data_prep.synthetic.articulated import articulated_figure

    alone = articulated_figure(figures, index)
    write_matching_folder(folder, [alone.mesh], [alone.template_to_shape])


def _chosen(
    name: str,
    shapes: ShapesWithTruth,
    folder: Path,
    train: str,
    test: str,
    settings: MatchingBenchmarkSettings,
) -> BenchmarkShapes:
    train_on, test_on = (
        chosen_shapes(option, text, shapes.meshes, folder, settings.leave_out)
        for option, text in (("--train", train), ("--test", test))
    )
    pairs = shapes.known_pairs(test_on, settings.self_pairs)
    pairs = sorted(pairs, key=lambda pair: pair.x)  # so that distances are read once per shape
    return BenchmarkShapes(name, shapes.meshes, tuple(train_on), tuple(test_on), tuple(pairs))


def _as_text(chosen: range) -> str:
    return f"{chosen.start}:{chosen.stop}"

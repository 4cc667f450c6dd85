"""`workflow benchmark matching`: train on part of a folder of shapes, test on another part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from data_prep.matching_folder import read_matching_folder
from ssm_pipeline import storage
from ssm_pipeline.commands.matching_benchmark_settings import MatchingBenchmarkSettings
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.process import keep_large_blocks
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.methods import WITHOUT_NETWORK
from ssm_pipeline.records import Mesh, SpectralBasis, StudyError
from ssm_pipeline.stages.resumable_training import trained_matcher


def run_matching(
    data: Path,
    folder: Path,
    settings: MatchingBenchmarkSettings,
    train_range: range | None,
    test_range: range | None,
    checkpoint: Path | None,
    device: str,
    terminal: Terminal,
) -> pd.DataFrame:
    """summary.csv (a row as in the papers' tables), pairs.csv, pck.csv and pck.png in `folder`.

    data        see `data_prep.matching_folder`; ranges count its shapes in natural order. Without
                ranges all shapes are trained on and tested: said in the row's name.
    checkpoint  a trained matcher (matcher.pt) to test instead of training one.
    Spectral bases, the trained matcher and the geodesic matrices are kept in `folder`.
    """
    from ssm_pipeline.adaptation.correspond import correspond
    from ssm_pipeline.evaluation.matching_benchmark import run_matching_benchmark
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.training.matcher import load_matcher

    keep_large_blocks()
    shapes = read_matching_folder(data)
    everything = range(len(shapes.meshes))
    train_on, test_on = train_range or everything, test_range or everything
    for name, wanted in (("--train", train_on), ("--test", test_on)):
        if not wanted or wanted[-1] >= len(shapes.meshes):
            raise StudyError(
                f"{name} {wanted.start}:{wanted.stop} asked of {len(shapes.meshes)} shapes in "
                f"{data}; give a range within 0:{len(shapes.meshes)}."
            )

    def basis(mesh: Mesh) -> SpectralBasis:
        path = folder / "bases" / f"{key_of(_mesh_key(mesh), settings.spectral)}.npz"
        if not path.exists():
            storage.save(spectral_basis(mesh, settings.spectral), path)
        return storage.load(SpectralBasis, path)

    matcher_path, is_trained = checkpoint, settings.method not in WITHOUT_NETWORK
    if matcher_path is None and is_trained:
        meshes = [shapes.meshes[index] for index in train_on]
        rests_on = ([_mesh_key(mesh) for mesh in meshes], settings.spectral, settings.training)
        matcher_path = trained_matcher(
            lambda: [basis(mesh) for mesh in meshes],
            settings.training,
            settings.seed,
            device,
            folder,
            key_of(*rests_on, settings.seed),
            "training",
            terminal,
        )
    matcher = load_matcher(matcher_path, device) if matcher_path is not None else None

    def predict(x: Mesh, y: Mesh) -> np.ndarray:
        match = correspond(basis(y), basis(x), matcher, settings.adaptation, settings.method)
        return match.nearest_vertex

    def geodesics(mesh: Mesh) -> np.ndarray:
        from ssm_pipeline.geometry.geodesics import geodesic_matrix

        path = folder / "geodesics" / f"{key_of(_mesh_key(mesh))}.npy"
        if not path.exists():
            with storage.written_whole(path) as temporary:
                np.save(temporary, geodesic_matrix(mesh.vertices, mesh.faces).astype(np.float32))
        return np.load(path)

    tested = shapes.subset(test_on)
    trained_on = matcher.trained_on if matcher is not None and is_trained else ()
    overlap = {mesh.case_id for mesh in tested.meshes} & set(trained_on)
    seen = f" (trained on {len(overlap)} of the test shapes)" if overlap else ""
    method: str = settings.method + seen
    with terminal.steps("pairs", len(test_on) * (len(test_on) - 1)) as steps:
        result = run_matching_benchmark(
            tested.meshes,
            tested.template_to_shape,
            predict,
            geodesics,
            data.resolve().name,
            method,
            on_pair=lambda done, of: steps.advance_to(done),
        )
    tables = {"summary": result.summary, "pairs": result.pairs, "pck": result.curve}
    for name, table in tables.items():
        with storage.written_whole(folder / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False)
    _draw_curve(result.curve, result.summary, folder / "pck.png")
    return result.summary


def _mesh_key(mesh: Mesh) -> str:
    """Hash of a mesh's shape; its name does not count."""
    return key_of_arrays(mesh.vertices, mesh.faces)


def _draw_curve(curve: pd.DataFrame, summary: pd.DataFrame, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 3), layout="constrained")
    axes = figure.add_subplot()
    row = summary.iloc[0]
    axes.plot(curve["threshold"], 100 * curve["share"], label=f"{row.method}: AUC {row.auc:.3f}")
    axes.set(
        xlabel="geodesic error / √area",
        ylabel="correct points (%)",
        title=f"{row.benchmark}, {row.pairs} pairs",
        ylim=(0, 101),
    )
    axes.legend()
    with storage.written_whole(path) as temporary:
        figure.savefig(temporary, dpi=200)

"""The built-in shapes of a matching benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.benchmark_shapes import built_in_shapes
from ssm_pipeline.experiments.matching_benchmark_settings import read_preset


def test_merged_figures_are_tested_onto_the_reference(tmp_path: Path) -> None:
    changes = ["built_in={training_shapes: 2, test_shapes: 2, persons: 1, vertices: 600}"]
    settings = read_preset("articulated-merged", changes)
    shapes = built_in_shapes("merged", tmp_path, settings, Terminal())
    assert shapes.train == (0, 1)
    assert shapes.test == (0, 2, 3)
    assert [(pair.x, pair.y) for pair in shapes.pairs] == [(0, 2), (0, 3)]
    reference, figure = shapes.meshes[0], shapes.meshes[2]
    assert shapes.pairs[0].on_x.max() < len(reference.vertices)
    assert (shapes.pairs[0].on_y == np.arange(len(figure.vertices))).all()

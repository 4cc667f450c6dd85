"""Scores that are kept: which changes make them again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapes import blob
from tiny_study import tiny_settings

from ssm_pipeline.comparison.anatomy import Anatomy
from ssm_pipeline.comparison.inputs import ComparisonInputs
from ssm_pipeline.comparison.producers import Learned
from ssm_pipeline.comparison.retrained_folds import Fold, fold_scores
from ssm_pipeline.comparison.scores import method_scores
from ssm_pipeline.engine.per_case import CaseResult, CaseTask
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import CaseError, CorrespondedShapes
from ssm_pipeline.shape_model.cohort_matching import MatchedCohort

CASES = ("a", "b", "c", "d")
MESH = blob(1, faces=60)
SHAPES = CorrespondedShapes(np.stack([MESH.vertices] * 4), MESH.faces, CASES, "a")


@pytest.fixture
def inputs(tmp_path: Path) -> ComparisonInputs:
    unused: Any = None
    return ComparisonInputs(
        folder=tmp_path,
        settings=tiny_settings(tmp_path),
        case_keys=dict.fromkeys(CASES, "case key"),
        mesh_keys=dict.fromkeys(CASES, "mesh key"),
        meshes=tuple(dataclasses.replace(MESH, case_id=case_id) for case_id in CASES),
        mesh_file=unused,
        patients=dict(zip(CASES, CASES, strict=True)),
        anatomy=Anatomy({}, ("tip",), {"a": np.zeros((1, 3))}),
        truth=None,
        pairs=unused,
        training=unused,
        map_cases=unused,
        map_here=unused,
        device="cpu",
        jobs=1,
        terminal=Terminal(),
    )


def with_settings(inputs: ComparisonInputs, **sections: dict[str, object]) -> ComparisonInputs:
    settings = inputs.settings.model_copy(
        update={
            name: getattr(inputs.settings, name).model_copy(update=changes)
            for name, changes in sections.items()
        }
    )
    return dataclasses.replace(inputs, settings=settings)


def changed_inputs(inputs: ComparisonInputs) -> dict[str, ComparisonInputs]:
    return {
        "number of points": with_settings(inputs, evaluation={"points": 201}),
        "removal of size": with_settings(inputs, shape_model={"with_scale": True}),
        "seed": dataclasses.replace(
            inputs, settings=inputs.settings.model_copy(update={"seed": 1})
        ),
    }


def key_of_scores(inputs: ComparisonInputs, score: Callable[[ComparisonInputs], object]) -> str:
    """The key that the scores would be kept with; nothing is scored."""
    keys: list[str] = []

    def refuse(tasks: Sequence[CaseTask], folder: Path) -> list[CaseResult]:
        keys.extend(task.key for task in tasks)
        return [CaseResult(task.case_id, task.key, dropped="a test") for task in tasks]

    inputs = dataclasses.replace(inputs, map_here=refuse)
    with pytest.raises(CaseError, match="a test"):
        score(inputs)
    return keys[0]


def test_scores_are_made_again_for_all_that_they_depend_on(inputs: ComparisonInputs) -> None:
    def key(changed: ComparisonInputs, shapes: CorrespondedShapes = SHAPES) -> str:
        matched = MatchedCohort(shapes, None)
        return key_of_scores(changed, lambda given: method_scores(given, "full", matched))

    changed = changed_inputs(inputs) | {
        "patients": dataclasses.replace(inputs, patients={**inputs.patients, "b": "a"}),
        "a mesh": dataclasses.replace(inputs, mesh_keys={**inputs.mesh_keys, "b": "another"}),
        "landmarks": dataclasses.replace(
            inputs, anatomy=Anatomy({}, ("tip",), {"a": np.ones((1, 3))})
        ),
    }
    keys = {name: key(other) for name, other in changed.items()}
    keys["shapes"] = key(inputs, dataclasses.replace(SHAPES, vertices=SHAPES.vertices + 1))
    keys["template"] = key(inputs, dataclasses.replace(SHAPES, template_id="b"))
    own = key(inputs)
    assert [name for name, other in keys.items() if other == own] == []
    # The number of processes does not change the scores, and another folder does not either.
    assert key(dataclasses.replace(inputs, jobs=2, folder=Path("elsewhere"))) == own


def test_scores_of_a_fold_are_made_again_for_all_that_they_depend_on(
    inputs: ComparisonInputs,
) -> None:
    def key(
        changed: ComparisonInputs,
        held_out: Sequence[int] = (0,),
        shapes: CorrespondedShapes = SHAPES,
    ) -> str:
        finished = {"full": lambda: MatchedCohort(shapes, None)}
        learned = Learned(Path("m.pt"), (), MESH, CASES[1:], changed.folder, finished)
        fold = Fold(1, np.array(held_out), 2, learned)
        return key_of_scores(changed, lambda given: fold_scores(given, fold, "full"))

    changed = changed_inputs(inputs) | {
        "a case": dataclasses.replace(inputs, case_keys={**inputs.case_keys, "b": "another"}),
    }
    keys = {name: key(other) for name, other in changed.items()}
    keys["held-out cases"] = key(inputs, (1,))
    moved = dataclasses.replace(SHAPES, vertices=SHAPES.vertices + 1)
    keys["shapes"] = key(inputs, shapes=moved)
    own = key(inputs)
    assert [name for name, other in keys.items() if other == own] == []

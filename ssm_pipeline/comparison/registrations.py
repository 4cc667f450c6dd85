"""The plain registrations that a study compares, up to date: alone, and with groupwise rounds."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import Registration
from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.pair_matching import all_matched


def registered_shapes(
    context: Context,
    registration: Registration,
    template: Mesh,
    meshes: Sequence[Mesh],
    folder: Path,
) -> CorrespondedShapes:
    """A template registered to every case, up to date in `folder`. Raises CaseError."""
    from ssm_pipeline.shape_model.collected_points import collect

    starts = dict.fromkeys(context.case_keys)
    matches = _registered(context, registration, template.case_id, starts, folder)
    return collect(template, matches, meshes)


def registered_rounds(
    context: Context,
    registration: Registration,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    folder: Path,
    mean_of: Collection[str] | None = None,
) -> CorrespondedShapes:
    """The study's groupwise rounds, each matching the mean by the same registration.

    The rounds are those of the study's own method (`shape_model.groupwise`), and so is their
    number. mean_of: as there.
    """
    from ssm_pipeline.shape_model.groupwise_rounds import groupwise_rounds

    def match(number: int, starts: Mapping[str, np.ndarray]) -> list[Correspondence]:
        place = folder / f"round-{number}"
        return _registered(context, registration, shapes.template_id, starts, place)

    return groupwise_rounds(shapes, meshes, context.settings.groupwise, match, mean_of)


def register_case(
    template_path: Path,
    case_path: Path,
    registration: Registration,
    settings: RegistrationSettings,
    start: np.ndarray | None,
    seed: int,
    folder: Path,
) -> Row:
    """correspondence.npz of a template, or of a mean shape already laid on the case."""
    from ssm_pipeline.baselines.register import register

    template, case = (storage.load(Mesh, path) for path in (template_path, case_path))
    match = register(template, case, registration, settings, start, seed)
    storage.save(match, folder / "correspondence.npz")
    return {"case_id": case.case_id, "template_id": template.case_id}


def _registered(
    context: Context,
    registration: Registration,
    template_id: str,
    starts: Mapping[str, np.ndarray | None],
    folder: Path,
) -> list[Correspondence]:
    settings = context.settings.comparison.registration
    # Meshes alone are read: training the networks anew leaves these results as they are.
    mesh_keys = context.done["meshing"].case_keys
    rests_on = [registration, settings, context.seed, mesh_keys[template_id]]
    tasks = [
        CaseTask(
            case_id,
            key_of(rests_on, mesh_keys[case_id], None if start is None else key_of_arrays(start)),
            partial(
                register_case,
                context.case_file("meshing", template_id, "mesh.npz"),
                context.case_file("meshing", case_id, "mesh.npz"),
                registration,
                settings,
                start,
                context.seed,
            ),
        )
        for case_id, start in starts.items()
    ]
    return all_matched(context, tasks, folder)

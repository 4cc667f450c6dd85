"""The plain registrations that a study compares, kept in files."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.comparison.inputs import ComparisonInputs, MethodUnavailable
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import Method
from ssm_pipeline.records import Correspondence, Mesh
from ssm_pipeline.runs.layout import CORRESPONDENCE
from ssm_pipeline.runs.pair_matching import all_matched


def require_package(method: Method) -> None:
    """Raises MethodUnavailable, which says what to install."""
    from ssm_pipeline.baselines.register import missing_package

    package = missing_package(method.base)
    if package:
        raise MethodUnavailable(
            f"the method {method.id} needs the package {package}, which is not installed; "
            'pip install "ssm-pipeline[rivals]"'
        )


def register_cases(
    inputs: ComparisonInputs,
    registration: str,
    template_id: str,
    starts: Mapping[str, np.ndarray | None],
    folder: Path,
) -> list[Correspondence]:
    """A template registered to each case, kept in `folder`.

    Args:
        starts: Case → `(V, 3)` mm, a shape on the template's faces that is placed on the case. None
            for the template itself, which is aligned rigidly.

    Raises:
        CaseError: A case could not be registered.
    """
    settings = inputs.settings.comparison.registration
    # Only meshes are read: these results stay as they are when networks are trained again.
    depends_on = [registration, settings, inputs.seed, inputs.mesh_keys[template_id]]
    tasks = [
        CaseTask(
            case_id,
            key_of(
                depends_on,
                inputs.mesh_keys[case_id],
                None if start is None else key_of_arrays(start),
            ),
            partial(
                write_registration,
                inputs.mesh_file(template_id),
                inputs.mesh_file(case_id),
                registration,
                settings,
                start,
                inputs.seed,
            ),
        )
        for case_id, start in starts.items()
    ]
    return all_matched(inputs.map_cases, tasks, folder)


def write_registration(
    template_path: Path,
    case_path: Path,
    registration: str,
    settings: RegistrationSettings,
    start: np.ndarray | None,
    seed: int,
    folder: Path,
) -> Row:
    """Write correspondence.npz of a template, or of a mean shape that is placed on the case."""
    from ssm_pipeline.baselines.register import register

    template, case = (storage.load(Mesh, path) for path in (template_path, case_path))
    match = register(template, case, registration, settings, start, seed)
    storage.save(match, folder / CORRESPONDENCE.name)
    return {"case_id": case.case_id, "template_id": template.case_id}

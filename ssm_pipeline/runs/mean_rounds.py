"""The groupwise rounds of a run, by files: the mean shape adapted to every case, up to date."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.keys import key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh, SpectralBasis
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.pair_matching import all_matched


def after_rounds(
    context: Context,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    folder: Path,
    mean_of: Collection[str] | None = None,
) -> CorrespondedShapes:
    """`groupwise_rounds` with each round's matches kept, up to date, in `folder/round-<r>/`."""
    from ssm_pipeline.shape_model.groupwise_rounds import groupwise_rounds

    settings = context.settings.adaptation
    template = context.case_file("spectral", shapes.template_id, "basis.npz")

    def match(number: int, starts: Mapping[str, np.ndarray]) -> list[Correspondence]:
        tasks = [
            CaseTask(
                case_id,
                context.case_key(case_id, key_of_arrays(start), settings, context.seed),
                partial(
                    readapt_case,
                    start,
                    template,
                    context.case_file("spectral", case_id, "basis.npz"),
                    settings,
                    context.seed,
                ),
            )
            for case_id, start in starts.items()
        ]
        return all_matched(context, tasks, folder / f"round-{number}")

    return groupwise_rounds(shapes, meshes, context.settings.groupwise, match, mean_of)


def readapt_case(
    start: np.ndarray,
    template_path: Path,
    case_path: Path,
    settings: AdaptationSettings,
    seed: int,
    folder: Path,
) -> Row:
    """correspondence.npz of a shape on the template's faces, laid on the case: (V, 3) mm."""
    from ssm_pipeline.adaptation.correspond import correspond_again

    template = storage.load(SpectralBasis, template_path)
    case = storage.load(SpectralBasis, case_path)
    match = correspond_again(start, template, case, settings, seed)
    storage.save(match, folder / "correspondence.npz")
    return {"case_id": case.case_id, "template_id": template.case_id}

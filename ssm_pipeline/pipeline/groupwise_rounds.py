"""Rounds in which the mean shape, in place of the template, is adapted to every case."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.pipeline.case_work import readapt_case
from ssm_pipeline.pipeline.keys import key_of_arrays
from ssm_pipeline.pipeline.per_case import CaseTask
from ssm_pipeline.pipeline.run import Run
from ssm_pipeline.pipeline.stage import StageContext
from ssm_pipeline.records import CaseError, CorrespondedShapes, Correspondence, Mesh


def matched_before_rounds(
    context: StageContext, run: Run, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """The template's matches with every case; meshes in the order of the cases."""
    from ssm_pipeline.shape_model.correspondence import collect

    matches = matches_in(context.folder("correspondence"), tuple(context.case_keys))
    return collect(run.mesh(run.template_id), matches, meshes)


def after_rounds(
    context: StageContext,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    folder: Path,
    mean_of: Collection[str] | None = None,
) -> CorrespondedShapes:
    """The shapes after `groupwise.rounds` rounds, each up to date in `folder/round-<r>/`.

    shapes, meshes  in the same order, each in its own millimetres.
    mean_of         the cases that the means are made of; None: all.
    Raises CaseError for a case that can't be matched.
    """
    from ssm_pipeline.shape_model.correspondence import points_on_cases
    from ssm_pipeline.shape_model.groupwise import placed_means

    settings = context.settings.adaptation
    template = context.case_file("spectral", shapes.template_id, "basis.npz")
    for number in range(1, context.settings.groupwise.rounds + 1):
        starts = placed_means(shapes, mean_of)
        matches = all_matched(
            context,
            [
                CaseTask(
                    case_id,
                    context.case_key(case_id, key_of_arrays(start), settings),
                    partial(
                        readapt_case,
                        start,
                        template,
                        context.case_file("spectral", case_id, "basis.npz"),
                        settings,
                    ),
                )
                for case_id, start in starts.items()
            ],
            folder / f"round-{number}",
        )
        shapes = points_on_cases(matches, meshes, shapes.faces)
    return shapes


def all_matched(
    context: StageContext, tasks: Sequence[CaseTask], folder: Path
) -> list[Correspondence]:
    """The correspondences that these tasks write, in their order. Raises CaseError."""
    for result in context.map_cases(tasks, folder=folder):
        if result.dropped is not None:
            raise CaseError(result.case_id, result.dropped)
    return matches_in(folder, [task.case_id for task in tasks])


def matches_in(folder: Path, case_ids: Sequence[str]) -> list[Correspondence]:
    """The correspondences that lie in a folder, a case each."""
    return [
        storage.load(Correspondence, folder / case_id / "correspondence.npz")
        for case_id in case_ids
    ]

"""A cohort as it is scored: shapes in the model's frame, each with its own mesh there."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model


@dataclass(frozen=True, eq=False)
class AlignedCohort:
    """N aligned shapes, and the cases' original meshes in the same frame and order.

    Attributes:
        with_scale: Whether the alignment removes size; distances are then those of scaled shapes.
    """

    shapes: CorrespondedShapes
    meshes: Sequence[Mesh]
    with_scale: bool = False

    def without(self, held_out: np.ndarray) -> tuple[ShapeModel, list[Similarity]]:
        """The model of the other cases, aligned again, and the frame of each held-out case.

        Args:
            held_out: Places of the cases that are left out.

        Returns:
            The model, and per held-out case the similarity that aligns it with that model.
        """
        model, frames = self.of_the_others(held_out)
        return model, [frames[int(case)] for case in held_out]

    def of_the_others(self, held_out: np.ndarray) -> tuple[ShapeModel, dict[int, Similarity]]:
        """As `without`, with the frames of all cases, kept and held out, by their places."""
        kept = np.setdiff1d(np.arange(len(self.shapes.case_ids)), held_out)
        aligned, kept_frames = align(self.shapes.subset(kept), with_scale=self.with_scale)
        model = pca_model(aligned)
        frames = dict(zip(kept.tolist(), kept_frames, strict=True))
        for case in np.asarray(held_out).tolist():
            shape = self.shapes.vertices[case]
            frames[case] = best_similarity(shape, model.mean, with_scale=self.with_scale)
        return model, frames


def align_cohort(
    corresponded: CorrespondedShapes, meshes: Sequence[Mesh], with_scale: bool = False
) -> tuple[AlignedCohort, tuple[Similarity, ...]]:
    """Shapes and meshes, each in the case's own millimetres, brought to the model's frame.

    Args:
        meshes: In any order, by case id.

    Returns:
        The cohort, and per case the frame from its own millimetres to the model's.

    Raises:
        StudyError: Where a case has no mesh.
    """
    aligned, frames = align(corresponded, with_scale=with_scale)
    moved = move_meshes(meshes, corresponded.case_ids, frames)
    return AlignedCohort(aligned, moved, with_scale), frames


def move_meshes(
    meshes: Sequence[Mesh], case_ids: Sequence[str], frames: Sequence[Similarity]
) -> list[Mesh]:
    """The cases' original meshes in the model's frame, in the order of `case_ids`.

    Raises:
        StudyError: Where a case has no mesh.
    """
    by_id = {mesh.case_id: mesh for mesh in meshes}
    missing = [case_id for case_id in case_ids if case_id not in by_id]
    if missing:
        raise StudyError(
            f"{len(missing)} of {len(case_ids)} corresponded cases have no mesh "
            f"({', '.join(missing[:5])}); pass the meshes the correspondences were made from."
        )
    return [moved(by_id[i], frame) for i, frame in zip(case_ids, frames, strict=True)]


def moved(mesh: Mesh, frame: Similarity) -> Mesh:
    return dataclasses.replace(mesh, vertices=frame.apply(mesh.vertices))

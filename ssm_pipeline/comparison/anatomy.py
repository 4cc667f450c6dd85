"""What experts marked on the cases: labels of parts and landmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.data_prep.cohorts.sides import is_mirrored
from ssm_pipeline.data_prep.formats.landmarks import LANDMARK_SUFFIXES, read_landmarks
from ssm_pipeline.engine.keys import key_of_files
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.methods import FULL
from ssm_pipeline.records import CorrespondedShapes, Mesh, Metrics, StudyError, SurfaceLabels
from ssm_pipeline.runs.landmark_file import FARTHEST_SHARE
from ssm_pipeline.study.settings import StudySettings

PAIRS = (
    "label_pairs",
    "landmark_pairs",
)  # a row per ordered pair; they stay in the folder of each method


@dataclass(frozen=True, eq=False)
class Anatomy:
    """The labels and landmarks of the cases; both may be empty.

    Attributes:
        labels: Case → the labels of its mesh.
        names: Of the L landmarks.
        landmarks: Case → `(L, 3)` mm.
    """

    labels: Mapping[str, SurfaceLabels]
    names: tuple[str, ...]
    landmarks: Mapping[str, np.ndarray]

    def tables(
        self,
        method: str,
        shapes: CorrespondedShapes,
        meshes: Sequence[Mesh],
        points: int,
        seed: int,
    ) -> dict[str, pd.DataFrame]:
        """Labels and landmarks transferred by a method's shapes: a row per pair, and per case."""
        from ssm_pipeline.evaluation.carried_labels import carried_labels, label_cases
        from ssm_pipeline.evaluation.carried_landmarks import carried_landmarks, landmark_cases

        tables: dict[str, pd.DataFrame] = {}
        if self.labels:
            by_id = {mesh.case_id: mesh for mesh in meshes}
            own = [by_id[case_id] for case_id in shapes.case_ids]
            labels = [self.labels[case_id] for case_id in shapes.case_ids]
            generator = np.random.default_rng(seed)  # the same samples for every method
            pairs = carried_labels(shapes, own, labels, points, generator)
            tables |= {"label_pairs": pairs, "labels": label_cases(pairs)}
        if self.landmarks:
            pairs = carried_landmarks(shapes, self.landmarks, self.names)
            tables |= {"landmark_pairs": pairs, "landmarks": landmark_cases(pairs)}
        for table in tables.values():
            table.insert(0, "method", method)
        return tables


def known_anatomy(
    settings: StudySettings, meshes: Sequence[Mesh], labels_of: Callable[[str], SurfaceLabels]
) -> Anatomy:
    """What is known of the cases.

    Args:
        labels_of: Case → the labels of its mesh, where the data has parts.

    Raises:
        StudyError: The landmarks can't be used.
    """
    labels = {}
    if settings.evaluation.labels and settings.data.has_parts:
        labels = {mesh.case_id: labels_of(mesh.case_id) for mesh in meshes}
    names: tuple[str, ...] = ()
    landmarks: dict[str, np.ndarray] = {}
    if settings.evaluation.landmarks is not None:
        mirrored = getattr(settings.data, "mirror", None)
        names, landmarks = landmarks_of_cases(settings.evaluation.landmarks, meshes, mirrored)
    return Anatomy(labels, names, landmarks)


def means_of_methods(
    scores: Mapping[str, Metrics], draws: int, seed: int, patients: Mapping[str, str]
) -> dict[str, pd.DataFrame]:
    """labels_mean and landmarks_mean, if known: a row per method, compared with `full`."""
    from ssm_pipeline.evaluation.carried_labels import label_means
    from ssm_pipeline.evaluation.carried_landmarks import landmark_means

    tables = {}
    for name, means in (("label", label_means), ("landmark", landmark_means)):
        pairs = pairs_of_methods(scores, name)
        if pairs:
            generator = np.random.default_rng(seed)
            tables[f"{name}s_mean"] = means(pairs, FULL, draws, generator, patients)
    return tables


def pairs_of_methods(scores: Mapping[str, Metrics], name: str) -> dict[str, pd.DataFrame]:
    """Method → its rows of single pairs, if any; name: "label" or "landmark"."""
    return {
        method: metrics.tables[f"{name}_pairs"]
        for method, metrics in scores.items()
        if f"{name}_pairs" in metrics.tables
    }


def without_pairs(scores: Mapping[str, Metrics]) -> dict[str, Metrics]:
    """The scores without their rows of single pairs, which are too many for one table."""
    return {
        method: Metrics({name: t for name, t in metrics.tables.items() if name not in PAIRS})
        for method, metrics in scores.items()
    }


def landmarks_of_cases(
    folder: Path, meshes: Sequence[Mesh], mirrored: str | None = None
) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    """The landmarks in the `<case id>.mrk.json` or `<case id>.fcsv` files of a folder.

    Args:
        mirrored: The side whose meshes are mirror images. Its landmarks are then mirrored too.

    Returns:
        Their names, and case → positions `(L, 3)` mm. Cases without a file are left out.

    Raises:
        StudyError: There are fewer than two files, a case has two, their names differ, or a
            landmark is far from the surface of its case.
    """
    names: tuple[str, ...] = ()
    positions: dict[str, np.ndarray] = {}
    for mesh in meshes:
        paths = [folder / f"{mesh.case_id}{suffix}" for suffix in LANDMARK_SUFFIXES]
        found = [path for path in paths if path.is_file()]
        if not found:
            continue
        if len(found) > 1:
            raise StudyError(
                f"evaluation.landmarks: {folder} holds {found[0].name} and {found[1].name}; one "
                "file per case is needed. Remove the older one."
            )
        path = found[0]
        read = read_landmarks(path, "evaluation.landmarks")
        names = names or tuple(sorted(read.names))
        if tuple(sorted(read.names)) != names or len(set(names)) < len(names):
            raise StudyError(
                f"{path} holds the landmarks {', '.join(sorted(read.names))}; the first case's "
                f"are {', '.join(names)}. The same names, each once, are needed in every file."
            )
        own = read.positions[[read.names.index(name) for name in names]]
        if is_mirrored(mesh.case_id, mirrored):
            own = own * [-1.0, 1.0, 1.0]
        distances = closest_points(own, mesh.vertices, mesh.faces).distances
        farthest = FARTHEST_SHARE * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        if distances.max() > farthest:
            raise StudyError(
                f"landmark {names[int(distances.argmax())]} of {path} lies "
                f"{distances.max():.1f} mm from the surface of case {mesh.case_id}; "
                f"{farthest:.1f} mm or less is needed. Place it on that case's own surface."
            )
        positions[mesh.case_id] = own
    if len(positions) < 2:
        raise StudyError(
            f"{folder} holds landmarks of {len(positions)} of the {len(meshes)} cases; two are "
            "needed to transfer them between cases. Name each file <case id>.mrk.json "
            f"or <case id>.fcsv, such as {meshes[0].case_id}.mrk.json, or "
            "leave evaluation.landmarks out."
        )
    return names, positions


def evaluation_depends_on(settings: StudySettings) -> Any:
    """Its settings and the content of the landmark files.

    Raises:
        StudyError: If there are none.
    """
    depends_on: dict[str, Any] = {
        "evaluation": settings.evaluation,
        "comparison": settings.comparison,
        "seed": settings.seed,
    }
    folder = settings.evaluation.landmarks
    if folder is not None:
        files = sorted(path for suffix in LANDMARK_SUFFIXES for path in folder.glob(f"*{suffix}"))
        if not files:
            found = "no folder" if not folder.is_dir() else "a folder without such files"
            raise StudyError(
                f"evaluation.landmarks: {folder} is {found}. Give the folder that holds a "
                "<case id>.mrk.json or <case id>.fcsv for each case, or leave it out."
            )
        depends_on["landmarks"] = {path.name: key_of_files([path]) for path in files}
    return depends_on

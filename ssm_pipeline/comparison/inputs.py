"""What the methods of a comparison are made of and scored on, the same for all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ssm_pipeline.comparison.anatomy import Anatomy, known_anatomy
from ssm_pipeline.engine.per_case import CaseTask
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import CaseError, Mesh, PhantomTruth, SurfaceLabels
from ssm_pipeline.runs.context import Context, patients_of, run_of
from ssm_pipeline.runs.layout import LABELS, MESH
from ssm_pipeline.runs.pair_matching import MapCases, PairWork
from ssm_pipeline.runs.resumable_training import TrainingWork
from ssm_pipeline.study.settings import StudySettings


class MethodUnavailable(ValueError):
    """A method that this study or this installation can't have. The message says why."""


@dataclass(frozen=True, eq=False)
class ComparisonInputs:
    """The cases of a study, and the means to work on them and keep the results.

    Attributes:
        folder: Holds the results of the comparison.
        settings: Of the whole study.
        case_keys: Case → the key of all that earlier stages made of it.
        mesh_keys: Case → the key of its mesh.
        meshes: In the order of the cases, each in its own millimetres.
        mesh_file: Case → the file of its mesh.
        patients: Case → patient.
        anatomy: Labels and landmarks of the cases.
        truth: Of a synthetic cohort.
        pairs: To match pairs.
        training: To train on some of the cases.
        map_cases: To work on cases in parallel.
        map_here: To work on all cases at once, in this process, which may start its own workers.
        device: Of the networks.
        jobs: Number of processes for work on all cases at once.
    """

    folder: Path
    settings: StudySettings
    case_keys: Mapping[str, str]
    mesh_keys: Mapping[str, str]
    meshes: tuple[Mesh, ...]
    mesh_file: Callable[[str], Path]
    patients: Mapping[str, str]
    anatomy: Anatomy
    truth: PhantomTruth | None
    pairs: PairWork
    training: TrainingWork
    map_cases: MapCases
    map_here: MapCases
    device: str
    jobs: int
    terminal: Terminal

    @staticmethod
    def of(context: Context, meshes: Sequence[Mesh]) -> ComparisonInputs:
        """The inputs of the evaluation stage.

        Raises:
            StudyError: The landmarks of the cases can't be used.
        """

        run = run_of(context)

        def labels_of(case_id: str) -> SurfaceLabels:
            return run.load(LABELS, case_id)

        return ComparisonInputs(
            folder=context.folder(),
            settings=context.settings,
            case_keys=context.case_keys,
            mesh_keys=context.done["meshing"].case_keys,
            meshes=tuple(meshes),
            mesh_file=partial(run.finished, MESH),
            patients=patients_of(context, list(context.case_keys)),
            anatomy=known_anatomy(context.settings, meshes, labels_of),
            truth=context.cohort.truth,
            pairs=PairWork.of(context),
            training=TrainingWork.of(context),
            map_cases=context.map_cases,
            map_here=partial(context.map_cases, in_this_process=True),
            device=context.device,
            jobs=context.jobs,
            terminal=context.terminal,
        )

    @property
    def seed(self) -> int:
        return self.settings.seed

    @property
    def case_ids(self) -> tuple[str, ...]:
        return tuple(self.case_keys)

    def patients_of(self, case_ids: Sequence[str]) -> dict[str, str]:
        return {case_id: self.patients[case_id] for case_id in case_ids}


def keep_result(inputs: ComparisonInputs, owner: str, task: CaseTask, folder: Path) -> Path:
    """Do one task on all cases at once, unless its result is up to date.

    Args:
        owner: Whose result it is, for the error.

    Returns:
        The folder of the result.

    Raises:
        CaseError: The task could not be done.
    """
    (result,) = inputs.map_here([task], folder)
    if result.dropped is not None:
        raise CaseError(owner, result.dropped)
    return folder / task.case_id

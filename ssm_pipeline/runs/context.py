"""What a stage of a study is given: the engine's context with the study's settings in it."""

from __future__ import annotations

from collections.abc import Sequence

from ssm_pipeline.cohort_check.copies import copy_pairs, held_together
from ssm_pipeline.engine.stage import StageContext
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.runs.layout import COPIES, TRAINING_BASIS
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.settings import StudySettings

Context = StageContext[StudySettings]


def run_of(context: Context) -> Run:
    """The run as a stage may read it: files of the stages in `needs`, and its own."""
    return Run(context.run_folder, context.readable)


def patients_of(context: Context, case_ids: Sequence[str]) -> dict[str, str]:
    """Case → patient: the cases of one patient are held out together, and so are copies."""
    patients = {case.case_id: case.patient or case.case_id for case in context.cohort.cases}
    united = held_together(patients, copy_pairs(run_of(context).load(COPIES)))
    return {case_id: united[case_id] for case_id in case_ids}


def training_bases(context: Context, case_ids: Sequence[str] | None = None) -> list[SpectralBasis]:
    """The spectral bases of the coarser meshes that are trained on; by default of all cases."""
    wanted = context.case_keys if case_ids is None else case_ids
    return [run_of(context).load(TRAINING_BASIS, case_id) for case_id in wanted]

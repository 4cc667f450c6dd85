"""What a stage of a study is given: the engine's context with the study's settings in it."""

from __future__ import annotations

from collections.abc import Sequence

from ssm_pipeline import storage
from ssm_pipeline.cohort_check.copies import copy_pairs, held_together
from ssm_pipeline.engine.stage import StageContext
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.study.settings import StudySettings

Context = StageContext[StudySettings]


def patients_of(context: Context, case_ids: Sequence[str]) -> dict[str, str]:
    """Case → patient: the cases of one patient are held out together, and so are copies."""
    patients = {case.case_id: case.patient or case.case_id for case in context.cohort.cases}
    copies = storage.read_table(context.folder("cohort_check") / "copies.csv")
    united = held_together(patients, copy_pairs(copies))
    return {case_id: united[case_id] for case_id in case_ids}


def training_bases(context: Context, case_ids: Sequence[str] | None = None) -> list[SpectralBasis]:
    """The spectral bases of the coarser meshes that are trained on; by default of all cases."""
    return [
        storage.load(SpectralBasis, context.case_file("spectral", case_id, "training_basis.npz"))
        for case_id in (context.case_keys if case_ids is None else case_ids)
    ]

"""Cases of a cohort, loaded as what a test needs of them."""

from __future__ import annotations

from ssm_pipeline.records import CaseSource, Mask


def loaded_mask(case: CaseSource) -> Mask:
    """The mask of a case whose file holds a mask, not a surface."""
    mask = case.load()
    assert isinstance(mask, Mask)
    return mask

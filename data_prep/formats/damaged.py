"""The error for a file that is not whole."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline.records import CaseError


def damaged(path: Path, case_id: str, what: str) -> CaseError:
    """The error for a file that is cut short or changed; `what` says how that shows."""
    return CaseError(
        case_id,
        f"{path.name} is damaged or cut short ({what}); the whole file is needed. "
        "Copy or download it again.",
    )

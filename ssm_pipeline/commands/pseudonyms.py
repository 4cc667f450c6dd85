"""Pseudonyms of a run's cases, the same in every export, and the file that is the key to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage

KEY_FILE = "pseudonyms.csv"


def pseudonyms_of(case_ids: Sequence[str], run_folder: Path) -> dict[str, str]:
    """Case id → case_001, …; new cases take the next free numbers and are added to the key file.

    A number is never given twice, even if its case has left the study: two exports of a study that
    grew must not call two people by one name.
    """
    path = run_folder / KEY_FILE
    known: dict[str, str] = {}
    if path.is_file():
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        known = dict(zip(table["case_id"], table["pseudonym"], strict=True))
    new = [case_id for case_id in case_ids if case_id not in known]
    if new:
        known |= {
            case_id: f"case_{number:03d}"
            for number, case_id in enumerate(new, start=len(known) + 1)
        }
        table = pd.DataFrame({"case_id": list(known), "pseudonym": list(known.values())})
        with storage.written_whole(path) as temporary:
            table.to_csv(temporary, index=False)
    return {case_id: known[case_id] for case_id in case_ids}

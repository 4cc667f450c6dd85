"""Pseudonyms of a run's cases, the same in every export, and the file that is the key to them."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.records import StudyError

KEY_FILE = "pseudonyms.csv"


def pseudonyms_of(case_ids: Sequence[str], run_folder: Path) -> dict[str, str]:
    """Case id → case_001, …; new cases take the next free numbers and are added to the key file,
    which only its owner may read.

    A number is never given twice, even if its case has left the study: two exports of a study that
    grew must not call two people by one name. Which new case gets which number is drawn by the
    system's own generator, not by the study's seed: ids are often sorted by date or name, and who
    knows them must not be able to count.
    """
    path = run_folder / KEY_FILE
    known = _known(path)
    new = [case_id for case_id in case_ids if case_id not in known]
    if new:
        secrets.SystemRandom().shuffle(new)
        known |= {
            case_id: f"case_{number:03d}"
            for number, case_id in enumerate(new, start=len(known) + 1)
        }
        _write(known, path)
    return {case_id: known[case_id] for case_id in case_ids}


def forget_pseudonym(case_id: str, run_folder: Path) -> None:
    """Nothing leads from the pseudonym to the case any more; its number stays taken."""
    path = run_folder / KEY_FILE
    known = _known(path)
    if case_id in known:
        number = known.pop(case_id)
        _write(known | {f"(withdrawn {number})": number}, path)


def _known(path: Path) -> dict[str, str]:
    """Case id → pseudonym of the key file.

    Raises:
        StudyError: For one that is damaged.
    """
    if not path.is_file():
        return {}
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        return dict(zip(table["case_id"], table["pseudonym"], strict=True))
    except (ValueError, KeyError) as error:
        # Never made again: new numbers would call two people by one name.
        raise StudyError(
            f"{path}, the key to the pseudonyms, is damaged ({error}). Copy it back from a backup, "
            "or move it away and all exports made with it."
        ) from error


def _write(known: dict[str, str], path: Path) -> None:
    table = pd.DataFrame({"case_id": list(known), "pseudonym": list(known.values())})
    storage.write_table(table.sort_values("pseudonym"), path, mode=0o600)

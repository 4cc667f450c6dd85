"""Which of the files found become the cases of a study."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from ssm_pipeline.data_prep.cohorts.patients import PatientRow, with_patients
from ssm_pipeline.data_prep.cohorts.sides import Side
from ssm_pipeline.data_prep.formats.image_files import is_dangling
from ssm_pipeline.records import CaseSource, Cohort, Dropped, StudyError

LONGEST_ID = 200  # bytes: the id names folders and, with a suffix, files; 255 is the system's limit
_OF_WINDOWS = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.I)
_OF_A_RUN = re.compile(
    r".*\.(csv|json|npz|pt|html|png|ya?ml|lock)|round-\d+|retrained-folds|paths", re.I
)


@dataclass(frozen=True)
class Choice:
    """Which of the cases found are taken, and how.

    Attributes:
        cases: Ids, in the order wanted; None: all.
        limit: At most so many; None: all.
        mirror: The side that is reflected, so that left and right are one cohort.
        exclude: Case id, or patient, → why it is left out.
        patients: Case id → its row of the patient table; empty: no table.
    """

    cases: tuple[str, ...] | None = None
    limit: int | None = None
    mirror: Side | None = None
    exclude: Mapping[str, str] = field(default_factory=dict)
    patients: Mapping[str, PatientRow] = field(default_factory=dict)


ALL = Choice()


def files_below(
    folder: Path, pattern: str | None, is_wanted: Callable[[Path], bool], what: str
) -> list[Path]:
    """The wanted files directly in a folder, or those below it that match a glob, sorted.

    Args:
        what: Names them in messages.

    Raises:
        StudyError: For a folder that is absent, a pattern that leaves it, or no file.
    """
    if not folder.is_dir():
        raise StudyError(f"there is no folder {folder}. Give the folder that holds the {what}.")
    if pattern is not None:
        _check_pattern(pattern)
    found = folder.iterdir() if pattern is None else folder.glob(pattern)
    files = sorted(path for path in found if is_wanted(path))
    if not files:
        matching = f" that match {pattern}" if pattern else ""
        raise StudyError(f"there are no {what}{matching} in {folder}. Check folder and pattern.")
    return files


def _check_pattern(pattern: str) -> None:
    parts = PurePath(pattern).parts
    if not pattern.strip() or PurePath(pattern).is_absolute() or ".." in parts:
        raise StudyError(
            f"the pattern {pattern!r} names no files below the folder; a glob relative to it is "
            'needed, such as "*/liver.nii.gz".'
        )
    if any("**" in part and part != "**" for part in parts):
        raise StudyError(f"the pattern {pattern!r} has ** within a name; it stands for folders.")


def unique_by_id(named_files: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """Case id → file, sorted by id.

    Raises:
        StudyError: If two files share one id.
    """
    by_id: dict[str, Path] = {}
    for case_id, path in sorted(named_files):
        if case_id in by_id:
            raise StudyError(
                f"two files share the case id {case_id}: {by_id[case_id]} and {path}. One file a "
                "case is needed: move one away, or give a pattern that matches only one of them."
            )
        by_id[case_id] = path
    return by_id


def choose(by_id: dict[str, Path], choice: Choice) -> dict[str, Path]:
    """The files of the cases chosen.

    Raises:
        StudyError: For a name that was not found or is given twice, or a limit below 1.
    """
    cases, limit = choice.cases, choice.limit
    if limit is not None and limit < 1:
        raise StudyError(f"limit is {limit}; at least 1 case is needed.")
    if cases is not None:
        if repeated := sorted({name for name in cases if cases.count(name) > 1}):
            raise StudyError(f"case {repeated[0]} is named twice; name each case once.")
        for name in cases:
            if name not in by_id:
                raise StudyError(_unknown(name, by_id))
        by_id = {name: by_id[name] for name in cases}
    return dict(list(by_id.items())[:limit])


def cohort_of(name: str, sources: Sequence[CaseSource], choice: Choice = ALL) -> Cohort:
    """The sources as a cohort, without those that the user excludes or whose id can't be used.

    Args:
        choice: Its patients and its excluded cases count here; the reason is shown beside the case.

    Raises:
        StudyError: For an excluded name that is no case, a reason left empty, or a patient table
            without a row of a case.
    """
    sources, exclude = with_patients(sources, choice.patients), choice.exclude
    known = {source.case_id for source in sources} | {source.patient for source in sources}
    for case_id, reason in exclude.items():
        if case_id not in known or not case_id:
            raise StudyError(f"data.exclude: {_unknown(case_id, known)}")
        if not reason.strip():
            raise StudyError(f"data.exclude: {case_id} needs a reason; write it behind the id.")
    kept: list[CaseSource] = []
    dropped: list[Dropped] = []
    for source in sources:
        excluded = exclude.get(source.case_id) or exclude.get(source.patient)
        reason = f"excluded: {excluded}" if excluded else why_unusable(source.case_id, source.files)
        if reason:
            dropped.append(Dropped(source.case_id, "data", reason))
        else:
            kept.append(source)
    return Cohort(name, tuple(kept), tuple(dropped))


def why_unusable(case_id: str, paths: Sequence[Path] = ()) -> str:
    """Why a case can't be used: its id can't name a folder, or a link leads nowhere; else empty.

    >>> why_unusable("patient 7"), why_unusable("quality.csv")[:43], why_unusable("nul")[:32]
    ('', "the id is a name that the run's own files h", 'the id is a name that Windows ke')
    """
    if len(case_id.encode()) > LONGEST_ID:
        return (
            f"the id is {len(case_id.encode())} bytes long, and {LONGEST_ID} are possible, since "
            "it names folders. Rename the file."
        )
    if _OF_A_RUN.fullmatch(case_id):
        return "the id is a name that the run's own files have. Rename the file."
    if _OF_WINDOWS.fullmatch(case_id):
        return "the id is a name that Windows keeps for a device. Rename the file."
    if not case_id.isprintable() or case_id != case_id.strip():
        return "the id holds characters that can't be seen. Rename the file."
    for path in filter(is_dangling, paths):
        return (
            f"{path.name} is a link to {path.readlink()}, which does not exist. Copy the file "
            "there, or correct the link."
        )
    return ""


def _unknown(name: str, known: Iterable[str]) -> str:
    known = [other for other in known if other]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {near[0]}?" if near else ""
    return f"there is no case {name} among the {len(known)} found.{hint}"

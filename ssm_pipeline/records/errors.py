"""Errors that the user can act on."""

from __future__ import annotations

from pathlib import Path


class CaseError(ValueError):
    """A case cannot be used. A study drops it and continues.

    The message names the case, what was found, what was needed and what to try.

    Args:
        case_id: The case.
        reason: The message without the case.
    """

    def __init__(self, case_id: str, reason: str) -> None:
        super().__init__(f"case {case_id}: {reason}")
        self.case_id = case_id
        self.reason = reason

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.case_id, self.reason)  # two arguments: survives worker processes


class StudyError(ValueError):
    """A whole study cannot run: too few cases, a wrong folder, settings that contradict."""


class DamagedFile(StudyError):
    """A file of this package cannot be read: missing, cut short, changed, or of another kind.

    Args:
        path: The file.
        found: What is wrong with it, as "is missing".
    """

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(
            f"{path} {found}. If a run made it, run the study again: damaged and missing files are "
            "made again. Otherwise copy the file from its origin again."
        )
        self.path, self.found = path, found

    def __reduce__(self) -> tuple[type, tuple[Path, str]]:
        return type(self), (self.path, self.found)  # survives worker processes

"""What stands in the way of a case or of a study, told to the user."""

from __future__ import annotations

from pathlib import Path


class CaseError(ValueError):
    """A case can't be used: says which, what was found, what was needed, what to try."""

    def __init__(self, case_id: str, reason: str) -> None:
        super().__init__(f"case {case_id}: {reason}")
        self.case_id = case_id
        self.reason = reason

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.case_id, self.reason)  # two arguments: survives worker processes


class StudyError(ValueError):
    """A whole study can't run (too few cases, wrong folder, clashing settings)."""


class DamagedFile(StudyError):
    """A file of ours can't be read back: missing, cut short, changed, or of another kind."""

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(
            f"{path} {found}. If a run made it, run the study again: what is damaged or missing is "
            "made again. Otherwise copy it again from where it came."
        )
        self.path, self.found = path, found

    def __reduce__(self) -> tuple[type, tuple[Path, str]]:
        return type(self), (self.path, self.found)  # survives worker processes

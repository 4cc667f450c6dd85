"""Which of the files found become the cases of a study."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

from ssm_pipeline.records import StudyError


def unique_by_id(named_files: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """Case id → file, sorted by id. Raises StudyError if two files share one id."""
    by_id: dict[str, Path] = {}
    for case_id, path in sorted(named_files):
        if case_id in by_id:
            raise StudyError(
                f"two files share the case id {case_id}: {by_id[case_id]} and {path}. One file a "
                "case is needed: move one away, or give a pattern that matches only one of them."
            )
        by_id[case_id] = path
    return by_id


def choose(
    by_id: dict[str, Path], cases: tuple[str, ...] | None, limit: int | None
) -> dict[str, Path]:
    """The named cases in the order named (all if None), at most `limit` of them.

    Raises StudyError for a name that was not found or is given twice, or a limit below 1.
    """
    if limit is not None and limit < 1:
        raise StudyError(f"limit is {limit}; at least 1 case is needed.")
    if cases is not None:
        if repeated := sorted({name for name in cases if cases.count(name) > 1}):
            raise StudyError(f"case {repeated[0]} is named twice; name each case once.")
        for name in cases:
            if name not in by_id:
                near = difflib.get_close_matches(name, by_id, n=1)
                hint = f" Did you mean {near[0]}?" if near else ""
                raise StudyError(f"there is no case {name} among the {len(by_id)} found.{hint}")
        by_id = {name: by_id[name] for name in cases}
    return dict(list(by_id.items())[:limit])

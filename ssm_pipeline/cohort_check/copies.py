"""Cases that are copies of each other: what to exclude, and who is held out together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import pandas as pd

SAME = "the same"  # of `check.twins`; the other kind is a mirror image
COLUMNS = ("case_id", "copy_of", "exclude")


def copies_table(twins: Iterable[tuple[str, str, str]]) -> pd.DataFrame:
    """One row per case that is a copy of an earlier one.

    Args:
        twins: (case, other case, kind) as `check.twins` returns them. Mirror images are no copies:
            they are different shapes to a model.

    Returns:
        case_id, copy_of, and the line `exclude` for `data.exclude` of the study.

    >>> copies_table([("a", "b", "the same"), ("b", "c", "the same")])["copy_of"].tolist()
    ['a', 'a']
    """
    pairs = [(one, other) for one, other, kind in twins if kind == SAME]
    order = list(dict.fromkeys(case_id for pair in pairs for case_id in pair))
    group = held_together({case_id: case_id for case_id in order}, pairs)
    rows = [
        (case_id, group[case_id], exclude_line(case_id, group[case_id]))
        for case_id in order
        if group[case_id] != case_id
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS), dtype=object)


def advice_on_copies(copies: pd.DataFrame) -> list[str]:
    """Lines on the copies of `copies_table`, with what to put into the study; none if there are
    none."""
    if copies.empty:
        return []
    return [
        f"{len(copies)} cases are copies of others. They are held out together, but the model "
        "counts both. Put into the study:",
        "data:",
        "  exclude:",
        *(f"    {line}" for line in copies["exclude"]),
    ]


def exclude_line(case_id: str, copy_of: str) -> str:
    """The line of `data.exclude` that leaves a copy out.

    >>> exclude_line("007", "lung_3")
    '"007": "copy of lung_3"'
    """
    return f'"{case_id}": "copy of {copy_of}"'


def held_together(patients: Mapping[str, str], copies: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Case → patient, with the patients of copies united under the name of the first.

    Args:
        patients: Case → patient.
        copies: Pairs of cases that are one. Pairs of other cases are ignored.

    >>> held_together({"a": "p", "b": "q", "c": "q", "d": "d"}, [("a", "b")])
    {'a': 'p', 'b': 'p', 'c': 'p', 'd': 'd'}
    """
    result = dict(patients)
    order = {name: place for place, name in enumerate(dict.fromkeys(patients.values()))}
    for one, other in copies:
        if one in result and other in result:
            kept, gone = sorted((result[one], result[other]), key=order.__getitem__)
            result = {case: kept if name == gone else name for case, name in result.items()}
    return result


def copy_pairs(table: pd.DataFrame) -> Sequence[tuple[str, str]]:
    """The pairs of `copies_table`."""
    return list(zip(table["case_id"], table["copy_of"], strict=True))

"""Case ids short enough for a table's column and a picture's caption."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence

LONGEST = 28  # characters that fit under a small picture
FEWEST = 6  # characters kept of a longer id


def short_names(case_ids: Sequence[str]) -> dict[str, str]:
    """Return, per case id, the name that the page shows.

    Ids of at most 28 characters stay. Of a longer id, the name keeps the part that tells the long
    ids apart: the last characters ("…853377"), the first ones, or the middle between a common
    beginning and a common end, whichever is shortest.

    >>> short_names(["a" * 40 + "1234567", "a" * 40 + "7654321"])["a" * 40 + "1234567"]
    '…234567'
    """
    names = {case_id: case_id for case_id in case_ids if len(case_id) <= LONGEST}
    # A few long ids do not shorten the others.
    distinct = sorted(set(case_ids) - set(names))
    if not distinct:
        return names
    begin = _shared(distinct)
    end = _shared([case_id[::-1] for case_id in distinct])
    tail = _fewest(distinct, lambda case_id, n: case_id[-n:])
    head = _fewest(distinct, _beginning)
    ways = [
        {c: c if len(c) <= tail else f"…{c[-tail:]}" for c in distinct},
        {
            c: c if len(_beginning(c, head)) == len(c) else f"{_beginning(c, head)}…"
            for c in distinct
        },
        {c: f"…{_middle(c, begin, end)}…" for c in distinct},
    ]
    unique = [way for way in ways if len({*way.values(), *names}) == len(distinct) + len(names)]
    # A beginning or an end reads better than a middle, where it is short enough.
    ends = [way for way in unique[:2] if max(map(len, way.values())) <= LONGEST // 2]
    return names | min(ends or unique, key=lambda way: max(map(len, way.values())))


def _beginning(case_id: str, count: int) -> str:
    """At least `count` characters, no word or number cut."""
    end = re.compile(r"\w*?(?=[\W_]|$)").match(case_id, count)
    return case_id[: end.end()] if end else case_id


def _middle(case_id: str, begin: int, end: int) -> str:
    """What lies between a common beginning and a common end, of these lengths, and not less."""
    last = len(case_id) - end
    return case_id[min(begin, max(last - FEWEST, 0)) : last].lstrip(" .-_")


def _shared(case_ids: Sequence[str]) -> int:
    """How many of the first characters all ids have in common."""
    same = (len(set(letters)) == 1 for letters in zip(*case_ids, strict=False))
    return sum(itertools.takewhile(bool, same))


def _fewest(case_ids: Sequence[str], cut: Callable[[str, int], str]) -> int:
    """The smallest length, from FEWEST up, at which all cut ids differ."""
    length = FEWEST
    while len({cut(case_id, length) for case_id in case_ids}) < len(case_ids):
        length += 1
    return length

"""Case ids short enough for a picture's caption."""

from __future__ import annotations

from collections.abc import Sequence

LONGEST = 28  # characters that fit under a small picture
FEWEST = 6  # characters kept of a longer id


def short_names(case_ids: Sequence[str]) -> dict[str, str]:
    """Case id → what the page calls it: the id, or "…" and as many of its last characters as tell
    the cases apart. LUNA16's series UIDs have 64 characters that differ in the last ones only.
    """
    if max(map(len, case_ids), default=0) <= LONGEST:
        return {case_id: case_id for case_id in case_ids}
    length = FEWEST
    while len({case_id[-length:] for case_id in case_ids}) < len(set(case_ids)):
        length += 1
    return {
        case_id: case_id if len(case_id) <= length else f"…{case_id[-length:]}"
        for case_id in case_ids
    }

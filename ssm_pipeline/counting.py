"""Numbers of things in messages: "1 case", "3 cases"."""

from __future__ import annotations


def counted(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun, in the singular or the plural.

    Args:
        number: How many.
        one: What stands after the number 1: a noun, or a noun and its verb.
        many: What stands after any other number; by default `one` with an "s".

    Example:
        >>> counted(1, "case"), counted(0, "case"), counted(2, "mesh", "meshes")
        ('1 case', '0 cases', '2 meshes')
        >>> counted(1, "case is no longer", "cases are no longer")
        '1 case is no longer'
    """
    return f"{number} {one if number == 1 else many or one + 's'}"

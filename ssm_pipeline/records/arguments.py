"""Checks of the types that a public function receives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

Kinds = type | tuple[type, ...]


def require_type(value: object, kinds: Kinds, argument: str, advice: str = "") -> None:
    """Refuse an argument of another type, by name.

    Args:
        value: What the caller passed.
        kinds: The accepted type, or several of them.
        argument: The argument's name, for the message.
        advice: What to do instead, a sentence.

    Raises:
        TypeError: For a value of another type.

    >>> require_type("liver.stl", int, "faces")
    Traceback (most recent call last):
    TypeError: faces is a str; int is needed.
    """
    if not isinstance(value, kinds):
        message = f"{argument} is a {type(value).__name__}; {_named(kinds)} is needed. {advice}"
        raise TypeError(message.rstrip())


def require_each(values: Iterable[Any], kinds: Kinds, argument: str, advice: str = "") -> None:
    """Refuse what is not a sequence of the accepted type.

    Args:
        values: What the caller passed.
        kinds: The accepted type of the items, or several of them.
        argument: The argument's name, for the message.
        advice: What to do instead, a sentence.

    Raises:
        TypeError: For a value that is not a list or tuple, and for an item of another type.

    >>> require_each(["liver.stl"], (int, float), "sizes")
    Traceback (most recent call last):
    TypeError: sizes[0] is a str; int or float is needed.
    """
    if not isinstance(values, Sequence) or isinstance(values, (str, bytes)):
        raise TypeError(
            f"{argument} is a {type(values).__name__}; a list of {_named(kinds)} is needed."
        )
    for index, value in enumerate(values):
        require_type(value, kinds, f"{argument}[{index}]", advice)


def _named(kinds: Kinds) -> str:
    return " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))

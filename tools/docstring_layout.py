"""Griffe extension: docstrings are shown as they are laid out, their examples as Python sessions.

The first paragraph is text; what follows is columns of names, shapes and units, which Markdown
would run together.
"""

from __future__ import annotations

import re
from typing import Any

import griffe


class DocstringLayout(griffe.Extension):
    """Fences the parts of each docstring."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = laid_out(obj.docstring.value)


def laid_out(text: str) -> str:
    """The first paragraph, the rest as text, and the example as a session."""
    head, _, rest = text.partition("\n\n")
    body, example = rest, ""
    if found := re.search(r"^[ ]*>>>", rest, flags=re.MULTILINE):
        body, example = rest[: found.start()], rest[found.start() :]
    parts = [head.strip()]
    if body.strip():
        parts.append(f"```text\n{body.rstrip()}\n```")
    if example.strip():
        parts.append(f"```pycon\n{example.rstrip()}\n```")
    return "\n\n".join(parts)

"""The check of a pseudonymised page: no former case id may be left in any of its texts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from typing import Any

from ssm_pipeline.report.template import VIEWER

_ID_KEYS = {"id", "wholeId", "template", "case", "cases"}  # of the viewer's JSON
_SHORT_NUMBER = re.compile(r"[\d.,]{1,5}")
_PART_OF_A_WORD = 6  # ids from this length on are also found inside longer words


def refuse_ids_left(html: str, ids: Sequence[str]) -> None:
    """Check the texts of a page: what it shows, what appears on hover, what its CSV files hold.

    Ids that the page's own text contains, such as "12" or "mean", can't be told from it. They are
    searched only where the page holds ids.

    Raises:
        ValueError: If one of `ids` is left.
    """
    texts = _Texts()
    texts.feed(html)
    texts.close()
    everything = "\n".join(texts.all).casefold()
    names = {text.casefold() for text in texts.of_ids}
    own_words = _own_words()
    left = []
    for case_id in ids:
        wanted = case_id.casefold()
        if _SHORT_NUMBER.fullmatch(wanted) or wanted in own_words:
            is_left = wanted in names
        elif len(wanted) >= _PART_OF_A_WORD:
            is_left = wanted in everything
        else:
            is_left = re.search(rf"(?<!\w){re.escape(wanted)}(?!\w)", everything) is not None
        if is_left:
            left.append(case_id)
    if left:
        raise ValueError(
            f"the pseudonymised page would still show {len(left)} of {len(ids)} case ids, such as "
            f"{left[0]}, and was not written. Look for the id in the study's name, its settings "
            "and its tables, and remove it there."
        )


def _own_words() -> set[str]:
    templates = (path.read_text(encoding="utf-8") for path in VIEWER.glob("*.html"))
    return {word for text in templates for word in re.findall(r"\w+", text.casefold())}


class _Texts(HTMLParser):
    """all: every text and attribute of the page, without pictures, style and script; of_ids: texts
    on hover and the ids of the viewer's JSON."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.all: list[str] = []
        self.of_ids: list[str] = []
        self._kind = ""  # of the element that the parser is in, where its text is not for reading

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value}
        self.all += [value for value in values.values() if not value.startswith("data:")]
        self.of_ids += [values["title"]] if "title" in values else []
        self._kind = tag if tag in ("script", "style") else ""
        if values.get("type") == "application/json":
            self._kind = "json"

    def handle_endtag(self, tag: str) -> None:
        self._kind = ""

    def handle_data(self, data: str) -> None:
        if self._kind == "json":
            for key, text in _strings(json.loads(data)):
                self.all.append(text)
                self.of_ids += [text] if key in _ID_KEYS else []
        elif not self._kind:
            self.all.append(data)


def _strings(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """(key, text) of every text inside; the key is the nearest."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, dict):
        for name, item in value.items():
            yield "", name
            yield from _strings(item, name)
    elif isinstance(value, list):
        for item in value:
            yield from _strings(item, key)

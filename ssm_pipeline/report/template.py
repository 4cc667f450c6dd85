"""The frame that every page shares: templates, style and script, all inside one file."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

VIEWER = Path(__file__).parent / "viewer"


def fill(
    template: str, description: Mapping[str, Any], blocks: Mapping[str, str], **values: Any
) -> str:
    """A page's text: a template of `viewer/` with what it shows.

    description  plain values, which the viewer reads as JSON; blocks: base64 text by element id;
    values       what the template itself names, escaped where they are text.
    Everything is inside: the page opens from a folder without a server.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(VIEWER),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["two_lines"] = two_lines
    # A "<" inside a script element could end it: case ids are the user's own text.
    text = json.dumps(description, allow_nan=False).replace("<", "\\u003c")
    return environment.get_template(template).render(
        style=(VIEWER / "style.css").read_text(encoding="utf-8"),
        script=(VIEWER / "viewer.js").read_text(encoding="utf-8"),
        description=text,
        blocks=blocks,
        **values,
    )


def two_lines(heading: str) -> str:
    """A heading that breaks once at most, near its middle: its other spaces don't break.

    >>> two_lines("95th percentile (mm)").split(" ")
    ['95th', 'percentile\\xa0(mm)']
    """
    spaces = [index for index, letter in enumerate(heading) if letter == " "]
    if not spaces:
        return heading
    at = min(spaces, key=lambda index: max(index, len(heading) - index - 1))
    whole = heading.replace(" ", "\N{NO-BREAK SPACE}")
    return f"{whole[:at]} {whole[at + 1 :]}"


def webp_address(image: np.ndarray) -> str:
    """An (H, W, 4) uint8 picture as a data address."""
    buffer = io.BytesIO()
    # WebP with transparency is about a sixth of PNG; every browser since 2020 shows it.
    Image.fromarray(image).save(buffer, "WEBP", quality=88, method=4)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode()

"""Fill the tables of README and the documentation with the figures of `docs/results/`.

    python tools/fill_tables.py

A page holds a table between two markers, and nothing else that is generated:

    <!-- table: lungs -->
    ...
    <!-- end of table -->

`docs/results/tables/lungs.txt` is the same table with the name of each figure in its place, such as
`{lungs/comparison/full/generalisation_surface_mm:.2f}`. `figures_in` says how figures are named.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from ssm_pipeline.experiments.results_file import figures_in

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
TABLE = re.compile(r"(<!-- table: ([\w-]+) -->\n)(?:(?!<!-- ).*\n)*(<!-- end of table -->)")
FIGURE = re.compile(r"\{([^{}]+):(\.\df)\}")


def pages() -> list[Path]:
    """The pages that may hold tables of results."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def table_from(template: str, figures: Mapping[str, float]) -> str:
    """Put the figures into a table's template.

    Args:
        template: Markdown with `{name:.2f}` for each figure.
        figures: Name → value.

    Returns:
        The Markdown table.

    Raises:
        KeyError: The results hold no figure of that name.

    >>> table_from("| full | {part/table/full/x_mm:.2f} |", {"part/table/full/x_mm": 2.456})
    '| full | 2.46 |'
    """
    return FIGURE.sub(lambda found: f"{figures[found[1]]:{found[2]}}", template)


def filled(page: str, figures: Mapping[str, float], templates: Path = RESULTS / "tables") -> str:
    """Return the page with every marked table made again from its template."""

    def table(found: re.Match[str]) -> str:
        template = (templates / f"{found[2]}.txt").read_text(encoding="utf-8").strip()
        return f"{found[1]}\n{table_from(template, figures)}\n\n{found[3]}"

    return TABLE.sub(table, page)


if __name__ == "__main__":
    results = figures_in(RESULTS)
    for path in pages():
        before = path.read_text(encoding="utf-8")
        after = filled(before, results)
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(f"filled the tables of {path.relative_to(ROOT)}")

"""A report under other case ids, in the order of these ids: for a page that is sent to others."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.ids_left import refuse_ids_left
from ssm_pipeline.report.page import page_html
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.statistics.compare import ShapeComparison

# No case id is expected here, and an id such as "2" would change them. The check of the final page
# includes them.
_LEFT_AS_THEY_ARE = {"study", "versions", "stages"}


def renamed_html(content: ReportContent, names: Mapping[str, str], settings: ReportSettings) -> str:
    """Return the page with a new id in place of every case id.

    A new id of one case may be the former id of another. So the page is first made with
    placeholders and checked, and the placeholders are replaced after that.

    Args:
        content: What the report shows.
        names: Case id → new id, for every id of `content.names`.
        settings: Of the page.

    Raises:
        ValueError: If an id has no new one, or if the page would still show a former id.
    """
    order = sorted(names, key=lambda case_id: names[case_id])
    placeholders = {case_id: f"~{rank:06d}~" for rank, case_id in enumerate(order)}
    html = page_html(renamed(content, placeholders), settings)
    refuse_ids_left(html, list(names))
    final = {placeholders[case_id]: names[case_id] for case_id in order}
    return re.sub(r"~\d{6}~", lambda found: final.get(found[0], found[0]), html)


def renamed(content: ReportContent, names: Mapping[str, str]) -> ReportContent:
    """Replace every case id of a report, in tables, settings and sentences.

    Args:
        content: What the report shows.
        names: Case id → new id, for every id of `content.names`.

    Returns:
        The same content, with the cases in the order of their new ids: the former order would
        tell which case is which.

    Raises:
        ValueError: If an id has no new one.
    """
    if missing := sorted(set(content.names) - set(names)):
        raise ValueError(f"no new id for {', '.join(missing[:5])}; each case needs one")
    rename = _renamer(names)
    ids = content.aligned.case_ids
    order = sorted(range(len(ids)), key=lambda index: names[ids[index]])
    new_ids = tuple(names[ids[index]] for index in order)
    with_arrays: dict[str, Any] = {
        "model": dataclasses.replace(
            content.model, scores=content.model.scores[order], case_ids=new_ids
        ),
        "aligned": dataclasses.replace(
            content.aligned,
            vertices=content.aligned.vertices[order],
            case_ids=new_ids,
            template_id=names[content.aligned.template_id],
        ),
        "frames": tuple(content.frames[index] for index in order),
        "meshes": tuple(
            sorted(
                (dataclasses.replace(mesh, case_id=names[mesh.case_id]) for mesh in content.meshes),
                key=lambda mesh: mesh.case_id,
            )
        ),
        "paths": tuple(
            dataclasses.replace(
                path, template_id=names[path.template_id], case_id=names[path.case_id]
            )
            for path in content.paths
        ),
        "comparisons": tuple(_comparison(one, rename) for one in content.comparisons),
    }
    # Every other field, also one that is added to `ReportContent` later.
    others = {
        field.name: rename(getattr(content, field.name))
        for field in dataclasses.fields(content)
        if field.name not in with_arrays and field.name not in _LEFT_AS_THEY_ARE
    }
    return dataclasses.replace(content, **with_arrays, **others)


def _renamer(names: Mapping[str, str]) -> Callable[[Any], Any]:
    """A function that replaces ids in text, and in text inside mappings, lists and tables."""
    longest_first = sorted(names, key=len, reverse=True)
    known = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, longest_first))})(?!\w)")

    def rename(value: Any) -> Any:
        if isinstance(value, str):
            return known.sub(lambda found: names[found[0]], value)
        if isinstance(value, pd.DataFrame):
            return _table(value, rename)
        if isinstance(value, Mapping):
            return {rename(key): rename(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(rename(item) for item in value)
        return value

    return rename


def _table(table: pd.DataFrame, rename: Callable[[Any], Any]) -> pd.DataFrame:
    words = [name for name in table if not pd.api.types.is_numeric_dtype(table[name])]
    table = table.assign(**{str(name): table[name].map(rename) for name in words})
    return table.sort_values("case_id", kind="stable") if "case_id" in table else table


def _comparison(comparison: ShapeComparison, rename: Callable[[Any], Any]) -> ShapeComparison:
    """The design's rows in the order of the new ids, as the model's scores are."""
    design = comparison.design
    covariates = design.covariates.assign(case_id=design.covariates["case_id"].map(rename))
    order = covariates["case_id"].reset_index(drop=True).sort_values(kind="stable").index
    return dataclasses.replace(
        comparison,
        design=dataclasses.replace(
            design,
            matrix=design.matrix[order],
            covariates=covariates.iloc[order].reset_index(drop=True),
        ),
    )

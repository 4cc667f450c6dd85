"""A report's content under other case ids, in their order: for a page that is sent to others."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.statistics.compare import ShapeComparison


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
    template = names[content.aligned.template_id]
    return dataclasses.replace(
        content,
        model=dataclasses.replace(
            content.model, scores=content.model.scores[order], case_ids=new_ids
        ),
        aligned=dataclasses.replace(
            content.aligned,
            vertices=content.aligned.vertices[order],
            case_ids=new_ids,
            template_id=template,
        ),
        frames=tuple(content.frames[index] for index in order),
        meshes=tuple(
            sorted(
                (dataclasses.replace(mesh, case_id=names[mesh.case_id]) for mesh in content.meshes),
                key=lambda mesh: mesh.case_id,
            )
        ),
        paths=tuple(
            dataclasses.replace(
                path, template_id=names[path.template_id], case_id=names[path.case_id]
            )
            for path in content.paths
        ),
        correspondence=_table(content.correspondence, rename),
        metrics={name: _table(table, rename) for name, table in content.metrics.items()},
        cohort=_table(content.cohort, rename),
        check=None if content.check is None else _table(content.check, rename),
        check_pictures={names[case_id]: png for case_id, png in content.check_pictures.items()},
        settings=rename(content.settings),
        comparisons=tuple(_comparison(one, rename) for one in content.comparisons),
    )


def _renamer(names: Mapping[str, str]) -> Callable[[Any], Any]:
    """A function that replaces ids in text, and in text inside mappings and lists."""
    longest_first = sorted(names, key=len, reverse=True)
    known = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, longest_first))})(?!\w)")

    def rename(value: Any) -> Any:
        if isinstance(value, str):
            return known.sub(lambda found: names[found[0]], value)
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

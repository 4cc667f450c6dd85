"""A new method is one entry in `methods.METHODS`, and one producer where its kind is new."""

from __future__ import annotations

import dataclasses
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from shapes import basis_of, blob
from tiny_study import NAME, tiny_settings

from ssm_pipeline import load_run, methods
from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.comparison import producers
from ssm_pipeline.comparison.inputs import ComparisonInputs, MethodUnavailable
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.methods import FULL, METHODS, Method
from ssm_pipeline.records import StudyError
from ssm_pipeline.shape_model.cohort_matching import MatchedCohort
from ssm_pipeline.study.settings import ComparisonSettings


def shrunk(inputs: ComparisonInputs, learned: producers.Learned, method: Method) -> MatchedCohort:
    """The shapes of the full method, at 95 % of their size."""
    shapes = producers.produce(inputs, learned, FULL).shapes
    middles = shapes.vertices.mean(axis=1, keepdims=True)
    smaller = middles + 0.95 * (shapes.vertices - middles)
    return MatchedCohort(dataclasses.replace(shapes, vertices=smaller), None)


def test_an_entry_and_a_producer_reach_tables_files_and_page(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = Method("shrunk, by 5 %", "the full method's shapes, made smaller", "shrunk")  # type: ignore[arg-type]
    monkeypatch.setattr(methods, "METHODS", (*METHODS, new))
    monkeypatch.setitem(cast(dict[str, producers.Producer], producers.PRODUCERS), "shrunk", shrunk)
    shutil.copytree(tiny_run, tmp_path / NAME)
    tiny = tiny_settings(tiny_run.parents[1] / "masks")
    changed = tiny.model_copy(update={"comparison": ComparisonSettings(methods=(new.id,))})
    folder = run_study(NAME, changed, RunOptions(tmp_path), Terminal())

    assert (folder / "evaluation" / "shrunk-by-5-%" / "scores" / "generalisation.csv").exists()
    comparison = pd.read_csv(folder / "evaluation" / "comparison.csv").set_index("method")
    assert list(comparison.index) == ["full", new.id]
    # The variance is that of all points, so it scales as the square of the size.
    scale = comparison.loc[new.id, "variance_mm2"] / comparison.loc["full", "variance_mm2"]
    assert scale == pytest.approx(0.95**2, rel=0.02)  # the alignment is not exactly the same
    saw = load_run(folder).metrics.tables["generalisation"].groupby("method")["matching_saw_case"]
    assert saw.all().to_dict() == {"full": True, new.id: False}  # it does not learn
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    label = "the full method&#39;s shapes, made smaller"
    row = rf'<th scope="row" title="{label}">{new.id}</th>\s*<td class="trait no">'
    assert re.search(row, page)  # "no": it uses no network


def test_an_entry_alone_is_matched_by_its_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    new = Method("centred", "the template as it lies", "pair", start="as scanned")
    case, template = basis_of(blob(1, faces=200)), basis_of(blob(2, faces=200))
    with pytest.raises(StudyError, match="there is no method 'centred'"):
        correspond_bases(template, case, None, AdaptationSettings(), "centred")
    monkeypatch.setattr(methods, "METHODS", (*METHODS, new))
    match = correspond_bases(template, case, None, AdaptationSettings(), "centred")
    np.testing.assert_array_equal(match.fitted, case.frame.apply(template.vertices))


def test_names_and_folders_are_unique() -> None:
    names = [method.id for method in METHODS]
    assert len(set(names)) == len(names)
    assert len({method.folder for method in METHODS}) == len(names)
    assert {method.base for method in METHODS} <= set(names)
    assert {method.kind for method in METHODS} == set(producers.PRODUCERS)


def test_an_unknown_name_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(
        ValueError, match=r"no method 'S3N': full, .*S3M tuned\. Did you mean S3M\?"
    ):
        ComparisonSettings(methods=("S3N",))
    with pytest.raises(ValueError, match="no method 'true correspondence'"):
        ComparisonSettings(methods=("true correspondence",))


def test_a_method_that_needs_a_network_is_unavailable_without_one(tmp_path: Path) -> None:
    settings = tiny_settings(tmp_path).model_copy(update={"matching": "none"})
    inputs = cast(ComparisonInputs, SimpleNamespace(settings=settings))
    learned = producers.Learned(tmp_path / "m.pt", (), blob(1, faces=60), None, tmp_path)
    with pytest.raises(MethodUnavailable, match=r"network start needs a network.*matching: none"):
        producers.produce(inputs, learned, "network start")

"""Stage `correspondence`: the template matched to every case."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.methods import FULL
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import MATCHER, PATH, TEMPLATE, TEMPLATE_LOSSES
from ssm_pipeline.runs.pair_matching import Pair, PairWork, write_match, write_path


def match_cases(context: Context) -> Outcome:
    """<case>/correspondence.npz, template → case; paths/<case>/path.npz for a few cases."""
    template_id = _template(context)
    settings = context.settings.adaptation
    trained, own = context.done["training"].key, context.case_keys[template_id]
    rests_on = [trained, own, settings, context.seed]
    matcher, method = _matcher_and_method(context)
    pairs = PairWork.of(context)

    def task(case_id: str, work: Callable[[Pair, Path], Row], also: object = None) -> CaseTask:
        pair = pairs.pair(template_id, case_id, matcher, method)
        return CaseTask(case_id, context.case_key(case_id, rests_on, also), partial(work, pair))

    results = context.map_cases([task(case_id, write_match) for case_id in context.case_keys])
    others = [r.case_id for r in results if r.dropped is None and r.case_id != template_id]
    count = min(context.settings.report.paths, len(others))
    chosen = {others[index * len(others) // count] for index in range(count)}
    starts = {result.case_id: result.row.get("start") for result in results}
    places = context.folder() / PATH.folder
    for place in places.glob("*"):
        if place.name not in chosen:  # of other settings
            shutil.rmtree(place)
    walked = [task(case_id, write_path, starts[case_id]) for case_id in sorted(chosen)]
    context.map_cases(walked, folder=places)
    storage.write_json(context.folder() / TEMPLATE.name, {"template_id": template_id})
    note = f"template {template_id}"
    if matcher is not None:
        counts = Counter(str(result.row["start"]) for result in results if result.dropped is None)
        note += f"; starts: {', '.join(f'{start} {n}' for start, n in counts.most_common())}"
    return context.outcome(results, note=note)


def _matcher_and_method(context: Context) -> tuple[Path | None, str]:
    if context.settings.matching == "none":
        return None, "adaptation only"
    return run_of(context).finished(MATCHER), FULL


def _template(context: Context) -> str:
    wanted = context.settings.template
    if wanted is None:
        losses = run_of(context).load(TEMPLATE_LOSSES)
        return str(losses.loc[losses["mean_loss"].idxmin(), "case_id"])
    if wanted not in context.case_keys:
        raise StudyError(
            f"the template {wanted} is not among the {len(context.case_keys)} cases left: "
            f"{', '.join(context.case_keys)}. Name one of them, or leave template out."
        )
    return wanted

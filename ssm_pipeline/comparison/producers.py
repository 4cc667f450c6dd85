"""The shapes of each compared method, up to date: one function per kind of method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ssm_pipeline.comparison.inputs import ComparisonInputs, MethodUnavailable
from ssm_pipeline.comparison.registrations import register_cases, require_package
from ssm_pipeline.comparison.s3m_rows import s3m_shapes
from ssm_pipeline.methods import FULL, Kind, Method, folder_name, method_named
from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh
from ssm_pipeline.runs.layout import CORRESPONDENCE, MATCHER, SHAPES
from ssm_pipeline.runs.pair_matching import match_mean, match_template, matches_in, round_folder
from ssm_pipeline.runs.resumable_training import matcher_of_cases
from ssm_pipeline.runs.run import Run
from ssm_pipeline.shape_model.cohort_matching import MatchedCohort, fitted_points, matched_cohort


@dataclass(frozen=True)
class Learned:
    """What the methods of a comparison share, and the cases that it was learned from.

    Attributes:
        matcher: The networks.
        matcher_depends_on: What decides them, beside the training of the run.
        template: It is matched to every case.
        seen: The cases that may decide all of this, a groupwise mean and S3M's network too; None:
            all of them.
        folder: Holds a folder per method.
        finished: Method → its shapes, where earlier stages have made them.
    """

    matcher: Path
    matcher_depends_on: tuple[str, ...]
    template: Mesh
    seen: tuple[str, ...] | None
    folder: Path
    finished: Mapping[str, Callable[[], MatchedCohort]] = field(default_factory=dict)

    def folder_of(self, method: str) -> Path:
        return self.folder / folder_name(method)


Producer = Callable[[ComparisonInputs, Learned, Method], MatchedCohort]


def produce(inputs: ComparisonInputs, learned: Learned, name: str) -> MatchedCohort:
    """The cases by one method, each in its own millimetres; only what is missing is computed.

    Raises:
        CaseError: The method can't do a case.
        MethodUnavailable: It needs an optional package that is not installed, or a network that
            the study does not have.
    """
    if name in learned.finished:
        return learned.finished[name]()
    method = method_named(name)
    return PRODUCERS[method.kind](inputs, learned, method)


def learned_by_run(inputs: ComparisonInputs, run: Run) -> Learned:
    """What the stages before learned from all cases, and the shapes that they made."""
    case_ids, rounds = inputs.case_ids, inputs.settings.groupwise.rounds
    template = run.mesh(run.template_id)
    once = run.stage_folder(CORRESPONDENCE.stage)
    last = round_folder(run.stage_folder(SHAPES.stage), rounds) if rounds else once

    def with_rounds() -> MatchedCohort:
        return MatchedCohort(run.shapes, fitted_points(matches_in(last, case_ids)))

    def without_rounds() -> MatchedCohort:
        return matched_cohort(template, inputs.meshes, lambda *_: matches_in(once, case_ids))

    return Learned(
        matcher=run.where(MATCHER),
        matcher_depends_on=(),
        template=template,
        seen=None,
        folder=inputs.folder,
        finished={FULL: with_rounds, "without groupwise": without_rounds},
    )


def _by_pairs(inputs: ComparisonInputs, learned: Learned, method: Method) -> MatchedCohort:
    """By `adaptation.correspond`."""
    if method.uses_network and inputs.settings.matching == "none":
        raise MethodUnavailable(
            f"the method {method.id} needs a network, and the study has none (matching: none)"
        )
    matcher, matcher_depends_on = _matcher_of(inputs, learned, method)
    template_id, folder = learned.template.case_id, learned.folder_of(method.id)

    def match(number: int, starts: Mapping[str, np.ndarray | None]) -> list[Correspondence]:
        means = {case_id: start for case_id, start in starts.items() if start is not None}
        if means:
            return match_mean(inputs.pairs, template_id, folder, number, means)
        return match_template(
            inputs.pairs,
            template_id,
            starts,
            method.base,
            matcher,
            matcher_depends_on,
            learned.folder_of(method.base),
        )

    groupwise = inputs.settings.groupwise if method.groupwise else None
    return matched_cohort(learned.template, inputs.meshes, match, groupwise, learned.seen)


def _matcher_of(
    inputs: ComparisonInputs, learned: Learned, method: Method
) -> tuple[Path | None, tuple[str, ...]]:
    """The networks that a method reads, and what decides them beside the training of the run."""
    if method.network != "spectral loss":
        return (learned.matcher, learned.matcher_depends_on) if method.uses_network else (None, ())
    training = inputs.settings.training.spectral_only()
    case_ids = inputs.case_ids if learned.seen is None else learned.seen
    folder, label = learned.folder_of(method.id), "training on the spectral loss alone"
    matcher = matcher_of_cases(inputs.training, case_ids, training, folder, label)
    return matcher, (matcher.stem,)


def _by_registration(inputs: ComparisonInputs, learned: Learned, method: Method) -> MatchedCohort:
    """By a plain registration; its groupwise rounds match the mean by the same registration."""
    require_package(method)

    def match(number: int, starts: Mapping[str, np.ndarray | None]) -> list[Correspondence]:
        rounds = learned.folder_of(method.id)
        folder = round_folder(rounds, number) if number else learned.folder_of(method.base)
        return register_cases(inputs, method.base, learned.template.case_id, starts, folder)

    groupwise = inputs.settings.groupwise if method.groupwise else None
    return matched_cohort(learned.template, inputs.meshes, match, groupwise, learned.seen)


def _by_s3m(inputs: ComparisonInputs, learned: Learned, method: Method) -> MatchedCohort:
    shapes = s3m_shapes(
        inputs, method, learned.template, learned.folder_of(method.base), learned.seen
    )
    return MatchedCohort(shapes, None)


def _by_the_truth(inputs: ComparisonInputs, learned: Learned, method: Method) -> MatchedCohort:
    from ssm_pipeline.evaluation.phantom_truth import true_correspondence

    if inputs.truth is None:
        raise ValueError(f"{method.id} needs a synthetic cohort, whose truth is known")
    template = template_as_matched(produce(inputs, learned, FULL).shapes)
    return MatchedCohort(true_correspondence(template, inputs.truth, inputs.case_ids), None)


PRODUCERS: dict[Kind, Producer] = {
    "pair": _by_pairs,
    "registration": _by_registration,
    "S3M": _by_s3m,
    "truth": _by_the_truth,
}


def template_as_matched(shapes: CorrespondedShapes) -> Mesh:
    """The template with its points as matched: groupwise rounds and S3M choose their own."""
    return Mesh(shapes.template, shapes.faces, shapes.template_id)

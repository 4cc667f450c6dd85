"""The corresponded shapes of each method that a study compares, up to date."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from ssm_pipeline.comparison.registrations import registered_rounds, registered_shapes
from ssm_pipeline.comparison.s3m_rows import s3m_shapes
from ssm_pipeline.engine.per_case import CaseTask
from ssm_pipeline.methods import (
    FULL,
    TRUTH,
    WITHOUT_NETWORK,
    Method,
    PairMethod,
    registration_of,
)
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.mean_rounds import after_rounds
from ssm_pipeline.runs.pair_matching import Pair, all_matched, match_pair, matched_once, matches_in
from ssm_pipeline.runs.resumable_training import matcher_of_cases
from ssm_pipeline.runs.run import Run


def method_folder(context: Context, method: str) -> Path:
    return _folder_in(context.folder(), method)


def _folder_in(folder: Path, method: str) -> Path:
    return folder / method.replace(",", "").replace(" ", "-")


class MissingPackage(ValueError):
    """A row of the comparison needs a package that is not installed."""


def require_package(method: Method) -> None:
    """Raises MissingPackage, which says what to install."""
    from ssm_pipeline.baselines.register import missing_package

    registration = registration_of(method)
    package = None if registration is None else missing_package(registration)
    if package:
        raise MissingPackage(
            f"the row {method} needs the package {package}, which is not installed; "
            'pip install "ssm-pipeline[rivals]"'
        )


@dataclass(frozen=True)
class Learned:
    """What the rows of a comparison have in common, and of which cases it was learned.

    matcher   the networks; rests_on: what, beside the run's own training, decides them.
    template  what is matched to every case.
    seen      the cases that all of it, a groupwise mean and S3M too, may look at; None: all.
    folder    holds a folder for each method.
    """

    matcher: Path
    rests_on: tuple[str, ...]
    template: Mesh
    seen: tuple[str, ...] | None
    folder: Path


def corresponded_shapes(
    context: Context, run: Run, method: Method, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """Each case in its own millimetres, of what the run learned from all of them.

    Raises CaseError for a case the method can't do, MissingPackage where it needs an optional one.
    """
    if method == FULL:
        return run.shapes
    template = run.mesh(run.template_id)
    if method == "without groupwise":
        return matched_once(context, template, meshes)
    matcher = context.folder("training") / "matcher.pt"
    learned = Learned(matcher, (), template, None, context.folder())
    return shapes_of(context, learned, method, meshes)


def shapes_of(
    context: Context, learned: Learned, method: Method, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """The cases by one method, each in its own millimetres, up to date. Raises as above.

    full                the study's own: network, adaptation, groupwise rounds
    without groupwise   network and adaptation, template → case
    network start       the same from the network's pose alone: the paper's method
    without adaptation  the map of the jointly trained features: the paper's row
    pose                the network's poses X(1)
    projected features  nearest features, projected on the eigenbasis; `features`: as they are
    spectral only       the same map, of features trained on the spectral loss alone
    adaptation only     rigid alignment and adaptation, no network; `, groupwise`: and the rounds
    as scanned          adaptation from where the scans lie; no alignment, no network
    nearest point       rigid alignment alone
    affine nearest, nricp, cpd
                        plain registrations (`baselines.register`); `, groupwise`: and the rounds
    S3M                 the baseline, with its published settings; `tuned`: with its tuned ones
    """
    require_package(method)
    template, seen = learned.template, learned.seen
    folder = _folder_in(learned.folder, method)

    def matched(pair_method: PairMethod, place: Path) -> CorrespondedShapes:
        no_network = pair_method in WITHOUT_NETWORK
        matcher, rests_on = (None, ()) if no_network else (learned.matcher, learned.rests_on)
        return matched_shapes(context, pair_method, template, matcher, rests_on, meshes, place)

    if method == "S3M" or method == "S3M tuned":
        published = context.settings.comparison.s3m
        settings, row = (published, "shapes") if method == "S3M" else (published.tuned(), "tuned")
        place = _folder_in(learned.folder, "S3M")
        return s3m_shapes(context, settings, template, meshes, place, row, seen)
    registration = registration_of(method)
    if registration is not None:
        alone = _folder_in(learned.folder, registration)
        shapes = registered_shapes(context, registration, template, meshes, alone)
        if method == registration:
            return shapes
        return registered_rounds(context, registration, shapes, meshes, folder, seen)
    if method == FULL or method == "without groupwise":
        folder = _folder_in(learned.folder, FULL)
        shapes = matched(FULL, folder)
        return shapes if method != FULL else after_rounds(context, shapes, meshes, folder, seen)
    if method == "adaptation only, groupwise":
        once = matched("adaptation only", _folder_in(learned.folder, "adaptation only"))
        return after_rounds(context, once, meshes, folder, seen)
    if method not in WITHOUT_NETWORK and context.settings.matching == "none":
        raise CaseError(
            "in the comparison", f"the study has no network (matching: none); {method} needs one."
        )
    if method == "spectral only":
        training, label = context.settings.training, "training on the spectral loss alone"
        case_ids = tuple(context.case_keys) if seen is None else seen
        matcher = matcher_of_cases(context, case_ids, training.spectral_only(), folder, label)
        return matched_shapes(context, method, template, matcher, (matcher.stem,), meshes, folder)
    return matched(cast(PairMethod, method), folder)  # all others have returned


def fitted_shapes(context: Context, method: str) -> np.ndarray | None:
    """(N, V, 3) mm: what `corresponded_shapes` were before they were carried onto the cases.

    None for S3M, whose points are the cases' own vertices, and for the truth.
    """
    rounds = context.settings.groupwise.rounds
    alone = method.removesuffix(", groupwise")
    if method == TRUTH or alone.startswith("S3M"):
        return None
    if method == FULL and rounds:
        folder = context.folder("groupwise") / f"round-{rounds}"
    elif method in (FULL, "without groupwise"):
        folder = context.folder("correspondence")
    elif method != alone and rounds:
        folder = method_folder(context, method) / f"round-{rounds}"
    else:
        folder = method_folder(context, alone)
    return np.stack([match.fitted for match in matches_in(folder, tuple(context.case_keys))])


def matched_shapes(
    context: Context,
    method: PairMethod,
    template: Mesh,
    matcher: Path | None,
    matcher_rests_on: tuple[str, ...],
    meshes: Sequence[Mesh],
    folder: Path,
) -> CorrespondedShapes:
    """A template matched to every case, up to date in `folder`. Raises CaseError.

    matcher_rests_on  what, beside the run's own training, decides the matcher.
    """
    from ssm_pipeline.shape_model.collected_points import collect

    settings, seed = context.settings.adaptation, context.seed
    rests_on = (method, template.case_id, settings, seed, *matcher_rests_on)
    matches = all_matched(
        context,
        [
            CaseTask(
                case_id,
                context.case_key(case_id, *rests_on),
                partial(match_pair, Pair.of(context, template.case_id, case_id, matcher, method)),
            )
            for case_id in context.case_keys
        ],
        folder,
    )
    return collect(template, matches, meshes)

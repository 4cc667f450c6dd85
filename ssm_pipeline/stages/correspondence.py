"""Stage `correspondence`: the template matched to every case."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.methods import PairMethod
from ssm_pipeline.records import CaseError, Correspondence, SpectralBasis, StudyError
from ssm_pipeline.stages.context import Context

if TYPE_CHECKING:  # at run time inside the functions: not every worker needs PyTorch
    from ssm_pipeline.records import CorrespondedShapes, Mesh


def match_cases(context: Context) -> Outcome:
    """<case>/correspondence.npz, template → case; <case>/path.npz for a few cases."""
    template_id = _template(context)
    settings = context.settings.adaptation
    others = [case_id for case_id in context.case_keys if case_id != template_id]
    count = min(context.settings.report.paths, len(others))
    with_path = {others[index * len(others) // count] for index in range(count)}
    trained, own = context.done["training"].key, context.case_keys[template_id]
    rests_on = [trained, own, settings, context.seed]
    matcher, method = _matcher_and_method(context)
    results = context.map_cases(
        [
            CaseTask(
                case_id,
                context.case_key(case_id, rests_on, case_id in with_path),
                partial(
                    correspond_case,
                    context.case_file("spectral", template_id, "basis.npz"),
                    context.case_file("spectral", case_id, "basis.npz"),
                    matcher,
                    settings,
                    method,
                    case_id in with_path,
                    context.seed,
                ),
            )
            for case_id in context.case_keys
        ]
    )
    storage.write_json(context.folder() / "template.json", {"template_id": template_id})
    note = f"template {template_id}"
    if matcher is not None:
        walked = sum(result.row.get("start") == "network" for result in results)
        note += f"; {walked} of {len(results)} from the network's pose, the others from rigid"
    return context.outcome(results, note=note)


def correspond_case(
    template_path: Path,
    case_path: Path,
    matcher_path: Path | None,
    settings: AdaptationSettings,
    method: PairMethod,
    with_path: bool,
    seed: int,
    folder: Path,
) -> Row:
    """correspondence.npz, and path.npz where one is wanted."""
    from ssm_pipeline.adaptation.correspond import correspond
    from ssm_pipeline.adaptation.path import shape_path

    template = storage.load(SpectralBasis, template_path)
    case = storage.load(SpectralBasis, case_path)
    matcher, coarse = None, None
    if matcher_path is not None:
        from ssm_pipeline.training.matcher import load_matcher  # PyTorch is needed for it alone

        matcher = load_matcher(matcher_path)
        coarse = (
            storage.load(SpectralBasis, template_path.with_name("training_basis.npz")),
            storage.load(SpectralBasis, case_path.with_name("training_basis.npz")),
        )
    match: Correspondence = correspond(template, case, matcher, settings, method, coarse, seed)
    storage.save(match, folder / "correspondence.npz")
    if with_path:
        walks = matcher if match.start == "network" else None  # to where the match was found
        path = shape_path(template, case, walks, settings, coarse, seed)
        storage.save(path, folder / "path.npz")
    return {"case_id": case.case_id, "template_id": template.case_id, "start": match.start}


def matched_once(
    context: Context, template: Mesh, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """What this stage found: the template's matches with every case; meshes in their order."""
    from ssm_pipeline.shape_model.correspondence import collect

    matches = matches_in(context.folder("correspondence"), tuple(context.case_keys))
    return collect(template, matches, meshes)


def all_matched(
    context: Context, tasks: Sequence[CaseTask], folder: Path
) -> list[Correspondence]:
    """The correspondences that these tasks write, in their order. Raises CaseError."""
    for result in context.map_cases(tasks, folder=folder):
        if result.dropped is not None:
            raise CaseError(result.case_id, result.dropped)
    return matches_in(folder, [task.case_id for task in tasks])


def matches_in(folder: Path, case_ids: Sequence[str]) -> list[Correspondence]:
    """The correspondences that lie in a folder, one per case."""
    return [
        storage.load(Correspondence, folder / case_id / "correspondence.npz")
        for case_id in case_ids
    ]


def _matcher_and_method(context: Context) -> tuple[Path | None, PairMethod]:
    if context.settings.matching == "none":
        return None, "adaptation only"
    return context.folder("training") / "matcher.pt", "full"


def _template(context: Context) -> str:
    wanted = context.settings.template
    if wanted is None:
        losses = storage.read_table(context.folder("training") / "template_losses.csv")
        return str(losses.loc[losses["mean_loss"].idxmin(), "case_id"])
    if wanted not in context.case_keys:
        raise StudyError(
            f"the template {wanted} is not among the {len(context.case_keys)} cases left: "
            f"{', '.join(context.case_keys)}. Name one of them, or leave template out."
        )
    return wanted

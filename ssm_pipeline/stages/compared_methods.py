"""The corresponded shapes of each method that a study compares, up to date."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import FULL, Method, PairMethod
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh
from ssm_pipeline.stages.context import Context
from ssm_pipeline.stages.correspondence import all_matched, correspond_case, matched_once
from ssm_pipeline.stages.groupwise import after_rounds
from ssm_pipeline.stages.resumable_training import matcher_of_cases
from ssm_pipeline.stages.run import Run


def method_folder(context: Context, method: str) -> Path:
    return context.folder() / method.replace(",", "").replace(" ", "-")


def corresponded_shapes(
    context: Context, run: Run, method: Method, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """Each case in its own millimetres. Raises CaseError for a case the method can't do.

    full                the study's own: network, adaptation, groupwise rounds
    without groupwise   network and adaptation, template → case: the paper's method
    without adaptation  the map of the jointly trained features: the paper's row
    pose                the network's poses X(1)
    projected features  nearest features, projected on the eigenbasis; `features`: as they are
    spectral only       the same map, of features trained on the spectral loss alone
    adaptation only     rigid alignment and adaptation, no network; `, groupwise`: and the rounds
    nearest point       rigid alignment alone
    S3M                 the baseline, with its published settings; `tuned`: with its tuned ones
    """
    if method == FULL:
        return run.shapes
    if method == "S3M" or method == "S3M tuned":
        settings = context.settings.comparison.s3m
        if method == "S3M tuned":
            settings = settings.tuned()
        return _by_s3m(context, method, settings, meshes)
    template, folder = run.mesh(run.template_id), method_folder(context, method)
    if method == "without groupwise":
        return matched_once(context, template, meshes)
    if method == "adaptation only, groupwise":
        once = corresponded_shapes(context, run, "adaptation only", meshes)
        return after_rounds(context, once, meshes, folder)
    if method == "adaptation only" or method == "nearest point":
        return matched_shapes(context, method, template, None, (), meshes, folder)
    if context.settings.matching == "none":
        raise CaseError(
            "in the comparison", f"the study has no network (matching: none); {method} needs one."
        )
    if method == "spectral only":
        training, label = context.settings.training, "training on the spectral loss alone"
        case_ids = tuple(context.case_keys)
        matcher = matcher_of_cases(context, case_ids, training.spectral_only(), folder, label)
        return matched_shapes(context, method, template, matcher, (matcher.stem,), meshes, folder)
    matcher = context.folder("training") / "matcher.pt"
    return matched_shapes(context, method, template, matcher, (), meshes, folder)


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
    from ssm_pipeline.shape_model.correspondence import collect

    adaptation = context.settings.adaptation
    rests_on = (method, template.case_id, adaptation, context.seed, *matcher_rests_on)
    matches = all_matched(
        context,
        [
            CaseTask(
                case_id,
                context.case_key(case_id, *rests_on),
                partial(
                    correspond_case,
                    context.case_file("spectral", template.case_id, "basis.npz"),
                    context.case_file("spectral", case_id, "basis.npz"),
                    matcher,
                    adaptation,
                    method,
                    False,
                    context.seed,
                ),
            )
            for case_id in context.case_keys
        ],
        folder,
    )
    return collect(template, matches, meshes)


def _by_s3m(
    context: Context, method: str, settings: S3MSettings, meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    folder = method_folder(context, method)

    def work(folder: Path) -> Row:
        import torch

        from ssm_pipeline.baselines.s3m.s3m import run_s3m

        def on_progress(phase: str, done: int, of: int) -> None:
            if done == of:
                context.terminal.say(f"      {method}: {phase}, {done} done")

        device = torch.device(context.device)
        result = run_s3m(meshes, settings, context.seed, device, on_progress)
        storage.save(result.points, folder / "points.npz")
        return {"template_id": result.template_id}

    # S3M reads the meshes alone: training our networks anew leaves its result as it is.
    mesh_keys = context.done["meshing"].case_keys
    rests_on = [mesh_keys[case_id] for case_id in context.case_keys]
    task = CaseTask("shapes", key_of(method, settings, context.seed, rests_on), work)
    (result,) = context.map_cases([task], jobs=1, folder=folder)
    if result.dropped is not None:
        raise CaseError("in the comparison", result.dropped)
    return storage.load(CorrespondedShapes, folder / "shapes" / "points.npz")

"""The pipeline: reading the list at the end of this file is reading the pipeline.

Each stage reads the files of the stages before it and writes into `runs/<study>/<stage>`. The calls
into the rooms are here, in `case_work.py` for work on one case, and in the modules named `…_stage`.
"""

from __future__ import annotations

from functools import partial

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.pipeline.case_work import basis_case, correspond_case, mesh_case
from ssm_pipeline.pipeline.cohort import what_a_case_rests_on
from ssm_pipeline.pipeline.evaluation_stage import evaluate_methods
from ssm_pipeline.pipeline.groupwise_rounds import after_rounds, matched_before_rounds
from ssm_pipeline.pipeline.per_case import CaseTask
from ssm_pipeline.pipeline.report_stage import what_the_report_rests_on, write_report
from ssm_pipeline.pipeline.run import Frames, Run
from ssm_pipeline.pipeline.stage import Outcome, Stage, StageContext
from ssm_pipeline.pipeline.training_stage import train_matcher
from ssm_pipeline.records import StudyError


def take_stock(context: StageContext) -> Outcome:
    """cohort.csv: the cases and the files they rest on."""
    rows = [
        {"case_id": case.case_id, "files": "; ".join(path.name for path in case.files)}
        for case in context.cohort.cases
    ]
    context.write_table("cohort", rows)
    rests_on = what_a_case_rests_on(context.settings)
    keys = {case_id: context.case_key(case_id, case_id, rests_on) for case_id in context.case_keys}
    return Outcome(keys, context.cohort.dropped)


def make_meshes(context: StageContext) -> Outcome:
    """<case>/mesh.npz; quality.csv."""
    settings = context.settings.meshing
    results = context.map_cases(
        [
            CaseTask(
                case.case_id,
                context.case_key(case.case_id, settings),
                partial(mesh_case, case, settings),
            )
            for case in context.cohort.cases
            if case.case_id in context.case_keys
        ]
    )
    context.write_table("quality", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def make_bases(context: StageContext) -> Outcome:
    """<case>/basis.npz and <case>/training_basis.npz; spectra.csv."""
    settings, faces = context.settings.spectral, context.settings.training.faces
    results = context.map_cases(
        [
            CaseTask(
                case_id,
                context.case_key(case_id, settings, faces),
                partial(
                    basis_case, context.case_file("meshing", case_id, "mesh.npz"), settings, faces
                ),
            )
            for case_id in context.case_keys
        ]
    )
    context.write_table("spectra", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def match_cases(context: StageContext) -> Outcome:
    """<case>/correspondence.npz, template → case; <case>/path.npz for a few cases."""
    template_id = _template(context)
    settings = context.settings.adaptation
    others = [case_id for case_id in context.case_keys if case_id != template_id]
    count = min(context.settings.report.paths, len(others))
    with_path = {others[index * len(others) // count] for index in range(count)}
    rests_on = [context.done["training"].key, context.case_keys[template_id], settings]
    results = context.map_cases(
        [
            CaseTask(
                case_id,
                context.case_key(case_id, rests_on, case_id in with_path),
                partial(
                    correspond_case,
                    context.case_file("spectral", template_id, "basis.npz"),
                    context.case_file("spectral", case_id, "basis.npz"),
                    context.folder("training") / "matcher.pt",
                    settings,
                    "full",
                    case_id in with_path,
                ),
            )
            for case_id in context.case_keys
        ]
    )
    storage.write_json(context.folder() / "template.json", {"template_id": template_id})
    return context.outcome(results, note=f"template {template_id}")


def match_mean(context: StageContext) -> Outcome:
    """round-<r>/<case>/correspondence.npz, mean shape → case; shapes.npz, the cohort as matched."""
    run = Run(context.run_folder)
    meshes = [run.mesh(case_id) for case_id in context.case_keys]
    shapes = matched_before_rounds(context, run, meshes)
    shapes = after_rounds(context, shapes, meshes, context.folder())
    storage.save(shapes, context.folder() / "shapes.npz")
    return Outcome(context.case_keys, note=f"{context.settings.groupwise.rounds} rounds")


def build_model(context: StageContext) -> Outcome:
    """aligned.npz with frames.npz, and model.npz."""
    from ssm_pipeline.shape_model.alignment import align
    from ssm_pipeline.shape_model.pca import build

    shapes, case_ids = Run(context.run_folder).shapes, tuple(context.case_keys)
    aligned, frames = align(shapes, with_scale=context.settings.shape_model.with_scale)
    model = build(aligned)
    folder = context.folder()
    storage.save(aligned, folder / "aligned.npz")
    storage.save(Frames(case_ids, frames), folder / "frames.npz")
    storage.save(model, folder / "model.npz")
    return Outcome(
        context.case_keys, note=f"{model.mode_count} modes, {model.modes_for(0.9)} hold 90 %"
    )


def _template(context: StageContext) -> str:
    wanted = context.settings.template
    if wanted is None:
        losses = pd.read_csv(context.folder("training") / "template_losses.csv", dtype={0: str})
        return str(losses.loc[losses["mean_loss"].idxmin(), "case_id"])
    if wanted not in context.case_keys:
        raise StudyError(
            f"the template {wanted} is not among the {len(context.case_keys)} cases left: "
            f"{', '.join(context.case_keys)}. Name one of them, or leave template out."
        )
    return wanted


STAGES = (
    Stage(
        "data",
        take_stock,
        lambda s: {"data": s.data.model_dump(mode="json", exclude={"folder"})},
    ),
    Stage("meshing", make_meshes, lambda s: s.meshing, needs=("data",)),
    Stage(
        "spectral",
        make_bases,
        lambda s: {"spectral": s.spectral, "training_faces": s.training.faces},
        needs=("meshing",),
    ),
    Stage(
        "training",
        train_matcher,
        lambda s: {"training": s.training, "seed": s.seed},
        needs=("spectral",),
    ),
    Stage(
        "correspondence",
        match_cases,
        lambda s: {"adaptation": s.adaptation, "template": s.template, "paths": s.report.paths},
        needs=("spectral", "training"),
        version=2,
    ),
    Stage(
        "groupwise",
        match_mean,
        lambda s: {"groupwise": s.groupwise, "adaptation": s.adaptation},
        needs=("spectral", "correspondence"),
    ),
    Stage("shape_model", build_model, lambda s: s.shape_model, needs=("groupwise",)),
    Stage(
        "evaluation",
        evaluate_methods,
        lambda s: {"evaluation": s.evaluation, "comparison": s.comparison, "seed": s.seed},
        needs=("shape_model",),
        version=2,
    ),
    Stage("report", write_report, what_the_report_rests_on, needs=("evaluation",)),
)

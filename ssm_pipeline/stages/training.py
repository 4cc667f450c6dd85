"""Train the matcher, from its last checkpoint if it was stopped, and rank the templates."""

from __future__ import annotations

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.matching.settings import COLLAPSED_EXTENT
from ssm_pipeline.runs.context import Context, training_bases
from ssm_pipeline.runs.layout import LOSSES, MATCHER
from ssm_pipeline.runs.resumable_training import (
    TrainingJob,
    key_of_start,
    train_resumably,
)
from ssm_pipeline.study.settings import StudySettings


def train_matcher(context: Context) -> Outcome:
    """matcher.pt, losses.csv (a row per step, if any) and template_losses.csv (a row per case).

    Where the study matches without a network, only template_losses.csv.
    """
    if context.settings.matching == "none":
        return _rank_templates(context)
    from ssm_pipeline.training.template_choice import choose_template

    settings, folder = context.settings.training, context.folder()
    bases = training_bases(context)
    job = TrainingJob(
        settings, context.seed, context.device, folder, context.key, "training", context.terminal
    )
    matcher, history = train_resumably(bases, job)
    _, template_losses = choose_template(matcher, bases)
    matcher.save(folder / MATCHER.name)
    rows = [{"step": step, **losses} for step, losses in enumerate(history, start=1)]
    if rows:
        context.write_table("losses", rows)
    else:
        storage.remove(folder / LOSSES.name)
    context.write_table("template_losses", template_losses.to_dict("records"))
    storage.remove(job.checkpoint)
    extent = template_losses["map_extent"].median()
    if extent < COLLAPSED_EXTENT:
        context.terminal.detail(
            "the map has collapsed: it maps every point towards the middle of the other shape "
            f"({100 * extent:.0f} % of its extent). All later results depend on it. Train longer "
            "(training.steps), or compare with the method adaptation only."
        )
    loss = template_losses["mean_loss"].mean()
    note = f"{counted(len(history), 'step')}, loss {loss:.3g}, map extent {100 * extent:.0f} %"
    return Outcome(context.case_keys, note=note)


def what_training_rests_on(settings: StudySettings) -> dict[str, object]:
    """Of the settings, with the content of the weights that training starts from."""
    training = settings.training
    return {
        "matching": settings.matching,
        "training": training,
        "start": key_of_start(training),
        "seed": settings.seed,
    }


def _rank_templates(context: Context) -> Outcome:
    from ssm_pipeline.adaptation.rigid_start import rank_templates_by_distance

    partners = context.settings.training.template_pairs
    ranked = rank_templates_by_distance(training_bases(context), partners, context.seed)
    for name in (MATCHER.name, LOSSES.name):  # of other settings
        storage.remove(context.folder() / name)
    context.write_table("template_losses", ranked.to_dict("records"))
    return Outcome(context.case_keys, note="no network")

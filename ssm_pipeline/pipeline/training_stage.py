"""Train the matcher, from its last checkpoint if it was stopped, and rank the templates."""

from __future__ import annotations

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.pipeline.stage import Outcome, StageContext
from ssm_pipeline.records import SpectralBasis


def train_matcher(context: StageContext) -> Outcome:
    """matcher.pt, losses.csv (a row a step) and template_losses.csv (a row a case)."""
    from ssm_pipeline.training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
    from ssm_pipeline.training.matcher import save_matcher
    from ssm_pipeline.training.template import choose_template
    from ssm_pipeline.training.train import train

    settings, folder = context.settings.training, context.folder()
    bases = [
        storage.load(SpectralBasis, context.case_file("spectral", case_id, "training_basis.npz"))
        for case_id in context.case_keys
    ]
    # The key is in the name: a checkpoint of other settings or other cases is never taken up.
    checkpoint_path = folder / f"checkpoint-{context.key}.pt"
    for stale in set(folder.glob("checkpoint-*.pt")) - {checkpoint_path}:
        stale.unlink()
    start: Checkpoint | None = None
    if checkpoint_path.exists():
        start = load_checkpoint(checkpoint_path)
        context.terminal.say(f"      training goes on after step {start.step}")
    history = list(start.history) if start else []
    with context.terminal.steps("training", settings.steps) as steps:

        def on_step(step: int, losses: dict[str, float]) -> None:
            history.append(losses)
            steps.advance_to(step, f"loss {losses['total']:.3g}")

        matcher = train(
            bases,
            settings,
            context.seed,
            device=context.device,
            start=start,
            on_checkpoint=lambda checkpoint: save_checkpoint(checkpoint, checkpoint_path),
            on_step=on_step,
        )
    _, template_losses = choose_template(matcher, bases)
    save_matcher(matcher, folder / "matcher.pt")
    rows = [{"step": step, **losses} for step, losses in enumerate(history, start=1)]
    context.write_table("losses", rows)
    with storage.written_whole(folder / "template_losses.csv") as temporary:
        template_losses.to_csv(temporary, index=False)
    checkpoint_path.unlink(missing_ok=True)
    last = pd.DataFrame(rows[-100:])["total"].mean()
    return Outcome(context.case_keys, note=f"{settings.steps} steps, loss {last:.3g}")

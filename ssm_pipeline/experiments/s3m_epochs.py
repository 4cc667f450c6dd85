"""`workflow benchmark s3m`: what S3M's scores are after fewer epochs than it was trained for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.s3m_rows import KEPT_EPOCHS, network_path, training_key
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.study.study import read_run_settings


def score_s3m_epochs(
    run_folder: Path,
    terminal: Terminal,
    epochs: Sequence[int] = KEPT_EPOCHS,
    device: str = "cpu",
    jobs: int = 1,
) -> pd.DataFrame:
    """evaluation/S3M/epochs.csv of a finished run: a row per epoch and setting of the filter.

    Columns: method (S3M or S3M tuned), epochs, loss (mean over that epoch), modes,
    generalisation_surface_mm and specificity_surface_mm at as many modes, and their standard errors
    (over cases; over draws), fit_surface_mm of the correspondences.
    Networks are those that the run's one training kept. Raises StudyError where it kept none.
    """
    import torch

    from ssm_pipeline.baselines.common_start import meshes_at_common_start
    from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint
    from ssm_pipeline.baselines.s3m.s3m import match_s3m
    from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method
    from ssm_pipeline.training.tensor_files import load_tensors

    run, settings = load_run(run_folder), read_run_settings(run_folder)
    published, folder = settings.comparison.s3m, run_folder / "evaluation" / "S3M"
    meshes = [run.mesh(case_id) for case_id in run.cases]
    template = run.mesh(run.template_id)
    record = StageRecord.read(run_folder / "meshing")
    assert record is not None  # or there would be no mesh
    key = training_key(published, settings.seed, record.case_keys, template.case_id, run.cases)
    wanted = {epoch: network_path(folder, key, epoch) for epoch in epochs}
    found = {epoch: path for epoch, path in wanted.items() if path.exists()}
    if not found:
        raise StudyError(
            f"{folder} holds no network of S3M after {', '.join(map(str, epochs))} epochs; let the "
            "run train it: S3M in comparison.methods, and workflow run."
        )
    aligned, _ = meshes_at_common_start(template, meshes, settings.seed)
    quick = settings.evaluation.model_copy(update={"jackknife_samples": 0, "fit_surfaces": False})
    scoring = Scoring(quick, settings.seed, settings.shape_model.with_scale, jobs)
    rows = []
    for epoch, path in found.items():
        trained = S3MCheckpoint(**load_tensors(path))
        for method, own in (("S3M", published), ("S3M tuned", published.tuned())):
            terminal.say(f"{method}, {epoch} epochs")
            match = match_s3m(
                aligned,
                trained,
                own,
                settings.seed,
                torch.device(device),
                lambda *step: None,
                jobs=jobs,
            )
            scores = evaluate_method(method, match.points, aligned, scoring).tables
            modes = int(scores["generalisation"]["modes"].max())
            cases = scores["generalisation"].query("modes == @modes")["surface_mm"]
            drawn = scores["specificity"].query("modes == @modes").iloc[0]
            rows.append(
                {
                    "method": method,
                    "epochs": epoch,
                    "loss": trained.losses[-1],
                    "modes": modes,
                    "generalisation_surface_mm": cases.mean(),
                    "generalisation_surface_se_mm": cases.sem(),
                    "specificity_surface_mm": drawn["surface_mm"],
                    "specificity_surface_se_mm": drawn["surface_se_mm"],
                    "fit_surface_mm": scores["correspondence"]["surface_mm"].mean(),
                }
            )
    table = pd.DataFrame(rows)
    storage.write_table(table, folder / "epochs.csv")
    return table

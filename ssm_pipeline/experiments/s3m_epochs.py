"""`workflow benchmark s3m`: the scores of S3M after fewer epochs than it was trained for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.s3m_rows import KEPT_EPOCHS, network_path, s3m_settings, training_key
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.methods import METHODS
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
    """Write evaluation/S3M/epochs.csv of a finished run: a row per epoch and method of this kind.

    The networks are those that the training of the run kept.

    Returns:
        method (S3M or S3M tuned), epochs, loss (mean over that epoch), modes,
        generalisation_surface_mm and specificity_surface_mm at this number of modes with their
        standard errors (over cases; over draws), and fit_surface_mm of the correspondences.

    Raises:
        StudyError: The training kept no network of these epochs.
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
    assert record is not None  # because the meshes were read
    key = training_key(published, settings.seed, record.case_keys, template.case_id, run.cases)
    wanted = {epoch: network_path(folder, key, epoch) for epoch in epochs}
    found = {epoch: path for epoch, path in wanted.items() if path.exists()}
    if not found:
        raise StudyError(
            f"{folder} holds no network of S3M after {', '.join(map(str, epochs))} epochs. List "
            "S3M in comparison.methods and run the study, which trains and keeps it."
        )
    aligned, _ = meshes_at_common_start(template, meshes, settings.seed)
    quick = settings.evaluation.model_copy(update={"jackknife_samples": 0, "fit_surfaces": False})
    scoring = Scoring(quick, settings.seed, settings.shape_model.with_scale, jobs)
    rows = []
    for epoch, path in found.items():
        trained = S3MCheckpoint(**load_tensors(path))
        for method in (method for method in METHODS if method.kind == "S3M"):
            terminal.say(f"{method.id}, {epoch} epochs")
            match = match_s3m(
                aligned,
                trained,
                s3m_settings(method, published),
                settings.seed,
                torch.device(device),
                lambda *step: None,
                jobs=jobs,
            )
            scores = evaluate_method(method.id, match.points, aligned, scoring).tables
            modes = int(scores["generalisation"]["modes"].max())
            cases = scores["generalisation"].query("modes == @modes")["surface_mm"]
            drawn = scores["specificity"].query("modes == @modes").iloc[0]
            rows.append(
                {
                    "method": method.id,
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

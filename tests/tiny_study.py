"""A study small enough for a test: four bumpy balls, every stage real, nothing accurate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.study.settings import StudySettings

NAME = "luna16"  # the name that README's example reads


def write_balls(folder: Path, count: int = 4) -> Path:
    """Label images of ellipsoids with a bump: no symmetry, 2 mm voxels, label 3."""
    folder.mkdir(parents=True)
    z, y, x = (np.indices((40, 40, 40)) - 20) * 2.0
    for index in range(count):
        a, b, c = 26 + 1.5 * index, 22 - 1.0 * index, 30 + 0.5 * index
        body = (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 < 1
        bump = (x - 18) ** 2 + (y - 8) ** 2 + (z - 12) ** 2 < (9 + index) ** 2
        image = sitk.GetImageFromArray((body | bump).astype(np.uint8) * 3)
        image.SetSpacing((2.0, 2.0, 2.0))
        sitk.WriteImage(image, str(folder / f"ball_{index}.nii.gz"))
    return folder


def tiny_settings(masks: Path, steps: int = 6) -> StudySettings:
    return StudySettings.model_validate(
        {
            "data": {"source": "masks", "folder": masks, "labels": [3]},
            "meshing": {"faces": 600},
            "spectral": {"eigenpairs": 20},
            "training": {
                "steps": steps,
                "faces": 400,
                "checkpoint_every": 2,
                "matching": {"channels": 16, "width": 16, "blocks": 1, "descriptors": 16},
                "interpolation": {"width": 8, "blocks": 1},
            },
            "adaptation": {"samples": 500, "steps": 3, "path_times": 3},
            "evaluation": {
                "points": 200,
                "samples": 20,
                "surface_samples": 5,
                "surface_points": 50,
                "screening_points": 50,
                "bootstrap_draws": 100,
                "jackknife_samples": 2,
            },
            "comparison": {
                "methods": ["adaptation only", "S3M"],
                "s3m": {"points": 150, "dense_points": 200, "epochs": 1, "eigenfunctions": 10},
            },
            "groupwise": {"rounds": 2},
            "report": {"modes": 2, "case_faces": 300, "paths": 1, "tile_px": 64},
        }
    )


def without_comparison(settings: StudySettings) -> StudySettings:
    """The same study with its own row alone, where other rows show nothing."""
    comparison = settings.comparison.model_copy(update={"methods": ()})
    return settings.model_copy(update={"comparison": comparison})


def run_tiny(
    masks: Path, runs: Path, steps: int = 6, terminal: Terminal | None = None, jobs: int = 1
) -> Path:
    options = RunOptions(runs, jobs=jobs)
    return run_study(NAME, tiny_settings(masks, steps), options, terminal or Terminal())

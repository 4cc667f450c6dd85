"""A disk that takes no more is one message, whoever writes: VTK, HDF5, ITK, pandas or NumPy.

The disk is a limit on the length of a file, in a process of its own, since VTK's writer once ended
the process that it ran in.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh

from ssm_pipeline import storage
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.phantoms import make_cohort
from ssm_pipeline.export.carried import write_labelled_surface
from ssm_pipeline.export.glb import write_glb
from ssm_pipeline.export.meshes import write_ply
from ssm_pipeline.export.statismo import write_statismo
from ssm_pipeline.export.vtp import write_vtp
from ssm_pipeline.records import Metrics, StudyError
from ssm_pipeline.shape_model.model import ShapeModel

LIMIT_BYTES = 4096
BALL = trimesh.creation.icosphere(3)
COUNT = len(BALL.vertices)
MODEL = ShapeModel(
    mean=30 * BALL.vertices,
    modes=np.linalg.qr(np.random.default_rng(0).standard_normal((3 * COUNT, 2)))[0].T.reshape(
        2, COUNT, 3
    ),
    variances=np.array([9.0, 4.0]),
    faces=np.asarray(BALL.faces),
    scores=np.zeros((1, 2)),
    case_ids=("a",),
)
LABELS = np.full(COUNT, "apex", dtype=object)
TABLE = Metrics({"table": pd.DataFrame(MODEL.mean)})
WRITERS: dict[str, Callable[[Path], object]] = {
    "model.npz": MODEL.save,
    "model.h5": lambda path: write_statismo(MODEL, path, "today"),
    "model.vtp": lambda path: write_vtp(MODEL, path),
    "model.glb": lambda path: write_glb(MODEL, path),
    "mean.ply": lambda path: write_ply(MODEL.mean, MODEL.faces, path),
    "labels.vtp": lambda path: write_labelled_surface(MODEL.mean, MODEL.faces, LABELS, path),
    "table.csv": lambda path: storage.save_tables(TABLE, path.parent),
    "phantom.000.mha": lambda path: make_cohort(path.parent, PhantomSettings(cases=4)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_takes_no_more_is_one_message(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    assert path.stat().st_size > LIMIT_BYTES
    for written in tmp_path.iterdir():
        written.unlink()

    def refused() -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT_BYTES, LIMIT_BYTES))
        try:
            WRITERS[name](path)
        except StudyError as error:
            sys.exit(0 if f"{name} can't be written: " in str(error) else 4)

    child = multiprocessing.get_context("fork").Process(target=refused)
    child.start()
    child.join()
    assert child.exitcode == 0
    assert not [left for left in tmp_path.iterdir() if not left.name.startswith("phantom.")]

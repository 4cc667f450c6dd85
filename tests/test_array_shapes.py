"""The shapes in the annotations of the records hold for what the public functions return."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

# In a process of its own: the hook has to be there before a module is imported.
CODE = """
import jaxtyping
import numpy as np
import pytest

checked = ("ssm_pipeline.records", "ssm_pipeline.shape_model.model")
with jaxtyping.install_import_hook(checked, "beartype.beartype"):
    import ssm_pipeline.records
    import ssm_pipeline.shape_model.model
import ssm_pipeline as ssm
from cohorts import bumpy_cohort, surfaces_of

shapes = bumpy_cohort(6, seed=3)
meshes = surfaces_of(shapes)
model = ssm.build_model(shapes)
model.posterior(np.arange(5), model.mean[:5], 1.0).marginal(np.arange(8)).truncate(1)
ssm.spectral_basis(meshes[0], 40)
quick = ssm.AdaptationSettings(samples=500, steps=2)
match = ssm.correspond(meshes[0], meshes[1], None, "nearest point", quick)
match.points_on(meshes[1])
mask = ssm.read_mask(np.ones((8, 8, 8), bool), spacing_mm=(1, 1, 1))
mask.to_world(np.zeros((4, 3)))

for wrong in (
    lambda: ssm.Correspondence("a", "b", match.case_faces[1:], *parts),
    lambda: ssm.Correspondence("a", "b", match.case_faces.astype(float), *parts),
    lambda: ssm.ShapeModel(
        model.mean, model.modes, model.variances, model.faces[:, :2], model.scores, model.case_ids
    ),
):
    parts = match.barycentric, match.nearest_vertex, match.fitted
    with pytest.raises(jaxtyping.TypeCheckError):
        wrong()
print("checked")
"""


def test_records_have_the_shapes_that_their_annotations_state() -> None:
    ran = subprocess.run(
        [sys.executable, "-c", CODE],
        check=False,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.endswith("checked\n")

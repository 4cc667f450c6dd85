"""The front door: what `import ssm_pipeline as ssm` offers, and what it costs."""

from __future__ import annotations

import ast
import doctest
import importlib.metadata
import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shapes import blob

import ssm_pipeline as ssm

FUNCTIONS = sorted(
    name
    for name in ssm.__all__
    if not name.startswith("__") and not isinstance(getattr(ssm, name), type)
)
# A study's run takes minutes; README's own code shows these two, and is run by tests.
WITHOUT_EXAMPLE = {"load_run", "run"}


def test_every_public_name_is_there_and_no_other() -> None:
    for name in ssm.__all__:
        assert getattr(ssm, name) is not None
    assert set(ssm._HOMES) == set(ssm.__all__) - {"__version__"}
    assert set(ssm.__all__) <= set(dir(ssm))
    with pytest.raises(AttributeError, match="no attribute 'brian'"):
        ssm.brian  # noqa: B018


def test_every_public_name_is_on_the_api_page() -> None:
    page = (Path(__file__).parents[1] / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^::: ssm_pipeline\.(\w+)$", page, flags=re.MULTILINE)
    assert sorted(listed) == sorted(set(ssm.__all__) - {"__version__"})


def test_type_checkers_see_the_same_names() -> None:
    source = Path(ssm.__file__).read_text(encoding="utf-8")
    block = next(n for n in ast.parse(source).body if isinstance(n, ast.If))
    homes = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert homes == ssm._HOMES
    assert Path(ssm.__file__).with_name("py.typed").exists()


def test_the_version_is_the_packages() -> None:
    assert ssm.__version__ == importlib.metadata.version("ssm-pipeline")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_public_function_says_what_it_takes_and_shows_it(name: str) -> None:
    function = getattr(ssm, name)
    text = inspect.getdoc(function) or ""
    assert len(text.splitlines()) > 1, "one line is not enough"
    assert "Raises" in text or name in ("spectral_basis", "correspond", "fit", "load_run"), text
    if name not in WITHOUT_EXAMPLE:
        assert doctest.DocTestParser().get_examples(text), "no example"


def test_importing_takes_no_heavy_library_and_surfaces_need_no_networks() -> None:
    code = (
        "import sys, ssm_pipeline as ssm\n"
        "assert not {'numpy', 'torch', 'vtk', 'pandas'} & set(sys.modules)\n"
        "ssm.read_mesh, ssm.Mesh, ssm.build_model, ssm.load_model, ssm.spectral_basis, ssm.fit\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_from_surfaces_in_memory_to_a_model_and_its_scores(tmp_path: Path) -> None:
    """The library's whole way; each step's own correctness is its room's affair."""
    meshes = [blob(seed, faces=900, case_id=f"case_{seed}") for seed in range(4)]
    matcher = ssm.train(meshes, steps=2, device="cpu")
    shapes = ssm.match_cohort(meshes, matcher, rounds=1, seed=3)
    assert shapes.case_ids == tuple(mesh.case_id for mesh in meshes)
    model = ssm.build_model(shapes)
    model.save(tmp_path / "blobs.npz")
    assert ssm.load_model(tmp_path / "blobs.npz").mode_count == 3
    from ssm_pipeline.evaluation.settings import EvaluationSettings

    quick = EvaluationSettings(points=300, samples=10, surface_samples=2)
    tables = ssm.evaluate(shapes, meshes, quick).tables
    assert tables["generalisation"]["case_id"].nunique() == 4
    # The model alone knows its cases; they lie where alignment put them.
    moved = [
        ssm.Mesh(vertices, model.faces, case_id)
        for vertices, case_id in zip(model.reconstruct(model.scores), model.case_ids, strict=True)
    ]
    again = ssm.evaluate(model, moved, quick).tables
    assert again["compactness"]["share"].to_numpy() == pytest.approx(
        tables["compactness"]["share"].to_numpy()
    )
    with pytest.raises(ssm.StudyError, match="must lie in the same place"):
        ssm.evaluate(shapes, [ssm.Mesh(m.vertices + 900, m.faces, m.case_id) for m in meshes])
    with pytest.raises(ssm.StudyError, match="2 modes of 4 cases"):
        ssm.evaluate(model.truncate(2), moved)
    with pytest.raises(ssm.StudyError, match="none of the cases"):
        ssm.match_cohort(meshes, matcher, template="case_9")


def test_the_seed_reaches_the_points_that_matching_draws() -> None:
    meshes = [blob(seed, faces=900, case_id=f"case_{seed}") for seed in range(3)]
    first, again, other = (
        ssm.match_cohort(meshes, None, method="adaptation only", rounds=1, seed=seed).vertices
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-6

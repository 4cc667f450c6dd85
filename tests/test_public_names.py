"""The public API: what `import ssm_pipeline as ssm` offers, and what it costs."""

from __future__ import annotations

import ast
import doctest
import importlib.metadata
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

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

# For calls with arguments of a wrong type, which a type checker would refuse.
lib: Any = ssm


QUICK = ssm.AdaptationSettings(samples=2000, steps=3)


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
    taken = [argument for argument in inspect.signature(function).parameters]
    for section in ("Args:", "Returns:", "Raises:"):
        assert re.search(rf"^{section}$", text, flags=re.MULTILINE), section
    said = re.findall(r"^    (\w+): ", text.split("Args:")[1].split("Returns:")[0], re.MULTILINE)
    assert said == taken
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
    """All steps together; each step's correctness is tested beside its package."""
    meshes = [blob(seed, faces=900, case_id=f"case_{seed}") for seed in range(4)]
    matcher = ssm.train(meshes, steps=2, device="cpu")
    shapes = ssm.match_cohort(meshes, matcher, rounds=1, settings=QUICK, seed=3)
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
        ssm.match_cohort(
            meshes, None, method="adaptation only", rounds=1, settings=QUICK, seed=seed
        ).vertices
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: lib.spectral_basis(m.vertices), "mesh is a ndarray; Mesh is needed"),
        (lambda m: lib.spectral_basis(m, "80"), "settings is a str; SpectralSettings or int"),
        (lambda m: lib.decimate("liver.stl", 500), "mesh is a str; Mesh is needed. Read a file"),
        (lambda m: lib.decimate(m, "500"), "faces is a str; int"),
        (lambda m: lib.read_mesh(["a.stl", "b.stl"]), "path is a list; str or Path is needed"),
        (lambda m: lib.train(m), "surfaces is a Mesh; a list of Mesh or SpectralBasis"),
        (lambda m: lib.train(["a.stl"]), r"surfaces\[0\] is a str; Mesh or SpectralBasis"),
        (lambda m: lib.correspond(m, "case.stl", None), "case is a str; Mesh or SpectralBasis"),
        (lambda m: lib.correspond(m, m, "liver.pt"), "matcher is a str; Matcher or NoneType"),
        (lambda m: lib.match_cohort("folder", None), "meshes is a str; a list of Mesh"),
        (lambda m: lib.build_model(m.vertices), "shapes is a ndarray; CorrespondedShapes"),
        (lambda m: lib.fit("model.npz", m), "model is a str; ShapeModel is needed. Read it with"),
        (lambda m: lib.evaluate(m, [m]), "shapes is a Mesh; CorrespondedShapes or ShapeModel"),
        (lambda m: lib.mesh_from_mask(m.vertices), "mask is a ndarray; Mask is needed. Read it"),
        (lambda m: lib.read_mask(m), "source is a Mesh; str or Path or ndarray is needed"),
        (lambda m: lib.read_mask(np.ones((9, 9, 9))), "pass spacing_mm="),
        (lambda m: lib.load_matcher(3), "path is a int; str or Path"),
        (lambda m: lib.run(["luna16"]), "study is a list; str or Path"),
    ],
)
def test_a_wrong_type_is_refused_by_name(call: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        call(blob(1, faces=200))


def test_the_number_of_eigenpairs_may_be_given_alone() -> None:
    mesh = blob(1, faces=400)
    assert ssm.spectral_basis(mesh, 80).eigenvalues.shape == (80,)


def test_training_in_python_reads_what_a_study_reads() -> None:
    from ssm_pipeline.study.study import read_study

    for name in ("luna16", "phantoms", "hippocampus", "spleen"):
        data = None if name == "phantoms" else Path()
        study = read_study(name, data).settings.training.matching
        assert study.features == ssm.TrainingSettings().matching.features


def test_every_nested_settings_class_is_public() -> None:
    from pydantic import BaseModel

    def nested(settings: type[BaseModel]) -> set[str]:
        kinds = [field.annotation for field in settings.model_fields.values()]
        inner = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
        return {k.__name__ for k in inner}.union(*(nested(k) for k in inner))

    public = [getattr(ssm, name) for name in ssm.__all__ if name.endswith(("Settings", "Weights"))]
    needed = set().union(*(nested(settings) for settings in public))
    assert {"MatchingSettings", "InterpolationSettings", "SpatialLossSettings"} <= needed
    assert needed <= set(ssm.__all__)


def test_every_setting_that_notation_names_is_printed_by_show(workflow: Any) -> None:
    notation = (Path(__file__).parents[1] / "NOTATION.md").read_text(encoding="utf-8")
    groups = "spectral|matching|training|adaptation|groupwise|spectral_loss|spatial_loss"
    named = set(re.findall(rf"`((?:{groups})\.[\w.*]+)(?:=[^`]*)?`", notation))
    assert {"spectral.eigenpairs", "adaptation.stiffness", "training.spectral_loss.*"} <= named
    import yaml

    shown = yaml.safe_load(workflow("show", "phantoms").stdout)
    for name in named:
        parts = name.removesuffix(".*").split(".")
        found = shown if parts[0] in ("training", *shown) else shown["training"]
        if parts[0] == "matching":  # a stage's switch has this name; its settings are training's
            found = shown["training"]
        for part in parts:
            assert part in found, name
            found = found[part]

"""A new surface compared with a model, with the same checks as `workflow fit`."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

from ssm_pipeline.fitting.cross_validation import CrossValidation, cross_validate
from ssm_pipeline.fitting.patient import FitReport, fit_patient
from ssm_pipeline.fitting.yardstick import Yardstick, drawn_cases, meshes_of, rebuilt_cases
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError, require_each, require_type
from ssm_pipeline.shape_model.model import ShapeModel

# The fits of a model's own cases take seconds to minutes, and are the same for every surface.
_Judges = tuple[CorrespondedShapes, list[Mesh], CrossValidation]
_KEPT: WeakKeyDictionary[ShapeModel, dict[tuple[bool, int], _Judges]] = WeakKeyDictionary()


def fit(
    model: ShapeModel,
    surface: Mesh,
    meshes: Sequence[Mesh] | None = None,
    with_scale: bool = False,
    seed: int = 0,
    jobs: int = 1,
) -> FitReport:
    """Fit a model to a new surface: pose, scores, reconstruction, and whether to believe them.

    The flags are those of `workflow fit`. They compare the fit with fits of the model's own cases,
    each by a model of the others. These are computed once for a model, and kept in memory.

    Args:
        model: A model of six cases or more with all its modes. A model of fewer cases, without
            them, or with fewer modes is judged by shapes drawn from it; its thresholds and
            intervals are too narrow.
        surface: In millimetres; open where it was cut off.
        meshes: The surfaces of the model's cases in the model's frame, in any order, by case_id.
            None: the cases as the model rebuilds them.
        with_scale: Whether the pose has a size, as for a model without one.
        seed: Decides the points that are drawn on both surfaces.
        jobs: The number of processes.

    Returns:
        `scores` `(M,)` in standard deviations with their 95 % intervals `low` and `high`;
        `vertices` `(V, 3)` mm, the fitted shape in the surface's own space; `frame`, model to
        surface; `radius_mm` `(V,)`; `flags`, a sentence for each finding out of the ordinary.

    Raises:
        TypeError: For arguments of other types.
        CaseError: Where no point of the model faces the surface.
        StudyError: For `meshes` that lack a case of the model.

    Source: Cootes 1995 (active shape models); Albrecht et al. 2013 for the posterior.

    Examples:
        >>> import numpy as np
        >>> import trimesh
        >>> from ssm_pipeline import CorrespondedShapes, build_model
        >>> ball = trimesh.creation.icosphere(2)
        >>> sizes = np.random.default_rng(0).normal([30, 40, 50], 3, (7, 3))
        >>> shapes = CorrespondedShapes(
        ...     sizes[:, None] * ball.vertices, ball.faces, tuple("abcdefg"), "a"
        ... )
        >>> model = build_model(shapes)
        >>> new = Mesh(ball.vertices * [31, 42, 48] + 100, ball.faces, "new")
        >>> fit(model, new).flags
        ()
        >>> in_metres = Mesh(new.vertices / 1000, ball.faces, "new")
        >>> fit(model, in_metres).flags[0]
        "units: it is 0.00... times as large as the model's mean. Is it in millimetres?"
    """
    require_type(model, ShapeModel, "model", "Read it with load_model.")
    require_type(surface, Mesh, "surface", "Read it with read_mesh.")
    return fit_patient(_yardstick_of(model, meshes, with_scale, seed, jobs), surface, None, seed)


def _yardstick_of(
    model: ShapeModel, meshes: Sequence[Mesh] | None, with_scale: bool, seed: int, jobs: int
) -> Yardstick:
    kept = _KEPT.setdefault(model, {})
    key = with_scale, seed
    if meshes is None and key in kept:
        return Yardstick(model, *kept[key], with_scale)
    shapes = rebuilt_cases(model) or drawn_cases(model, seed)
    surfaces = meshes_of(shapes) if meshes is None else _in_order(shapes.case_ids, meshes)
    reference = cross_validate(shapes, surfaces, with_scale, seed, jobs)
    if meshes is None:
        kept[key] = shapes, surfaces, reference  # not the model, which could then never be freed
    return Yardstick(model, shapes, surfaces, reference, with_scale)


def _in_order(case_ids: Sequence[str], meshes: Sequence[Mesh]) -> list[Mesh]:
    require_each(meshes, Mesh, "meshes")
    by_id = {mesh.case_id: mesh for mesh in meshes}
    missing = [case_id for case_id in case_ids if case_id not in by_id]
    if missing:
        raise StudyError(
            f"case {missing[0]} of the model has no mesh among {len(meshes)}; each case needs one "
            "with its case_id. A model of drawn shapes takes no meshes."
        )
    return [by_id[case_id] for case_id in case_ids]

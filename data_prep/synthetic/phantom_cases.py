"""The cases of a family of phantoms: how each is shaped, and how its scan was made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import SimpleITK as sitk
from scipy.spatial import cKDTree

from ssm_pipeline.data_prep.synthetic.phantom_family import PhantomFamily
from ssm_pipeline.data_prep.synthetic.phantom_flow import Combination, flow, random_velocity
from ssm_pipeline.data_prep.synthetic.phantom_pose import draw_frame
from ssm_pipeline.data_prep.synthetic.phantom_scan import (
    Handle,
    Slab,
    grid_around,
    occupancy,
    segmented,
    two_labels,
)
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import PhantomTruth, StudyError

_CUT = (0.04, 0.12)  # of the organ's height, where the field of view ends within it


@dataclass(frozen=True, eq=False)
class Case:
    """vertices (R, 3) mm as scanned; scores (M,); what its scan does to it; seed of its noise."""

    vertices: np.ndarray
    scores: np.ndarray
    frame: Similarity
    spacing_mm: tuple[float, float, float]
    shift: np.ndarray  # (3,) voxels, where the organ lies on them
    handles: tuple[Handle, ...]
    view: Slab
    noise_seed: np.random.SeedSequence


def family_named(name: str) -> PhantomFamily:
    """`lung` or `tube`; made when it is first asked for."""
    if name == "lung":
        from ssm_pipeline.data_prep.synthetic.phantom_lung import lung_family

        return lung_family()
    from ssm_pipeline.data_prep.synthetic.phantom_tube import tube_family

    return tube_family()


def draw_cases(family: PhantomFamily, settings: PhantomSettings) -> list[Case]:
    """Every case from a stream of its own: case k is the same in a larger cohort.

    Raises:
        StudyError: For more modes than the family has.
    """
    modes = family.modes[: settings.modes]
    if settings.modes is not None and len(modes) < settings.modes:
        raise StudyError(
            f"{settings.modes} modes asked of the phantom family {settings.family}, which has "
            f"{len(modes)}. Set data.modes to {len(modes)} or less, or leave it out."
        )
    residual_mm = family.residual_mm if settings.residual_mm is None else settings.residual_mm
    streams = np.random.SeedSequence(settings.seed).spawn(settings.cases)
    cases = []
    for stream in streams:
        *for_parts, for_noise = stream.spawn(5)
        for_shape, for_residual, for_pose, for_scan = map(np.random.default_rng, for_parts)
        scores = for_shape.standard_normal(len(modes))
        own = random_velocity(family.vertices, residual_mm, family.residual_widths_mm, for_residual)
        # The residual first: what the modes then do to it, they do to anatomy.
        vertices = flow(flow(family.vertices, own), Combination(tuple(scores), modes))
        frame = draw_frame(for_pose, settings, family.pivot)
        vertices = frame.apply(vertices)
        in_plane = float(for_scan.uniform(*family.in_plane_mm))
        drawn = (in_plane, in_plane, float(for_scan.uniform(*family.slice_mm)))
        shift = for_scan.random(3)
        cases.append(
            Case(
                vertices=vertices,
                scores=scores,
                frame=frame,
                spacing_mm=settings.spacing_mm or drawn,
                shift=shift,
                handles=_draw_handles(family, vertices, settings, for_scan),
                view=_draw_view(family, vertices, settings, for_scan),
                noise_seed=for_noise,
            )
        )
    return cases


def truth_of(family: PhantomFamily, cases: list[Case], settings: PhantomSettings) -> PhantomTruth:
    """Correspondences, labels, and which points each case's field of view shows.

    Its modes are the velocities at the mean: what small scores do. Large ones bend them.
    """
    vertices = np.stack([case.vertices for case in cases])
    return PhantomTruth(
        vertices=vertices,
        faces=family.faces,
        mean=family.vertices,
        modes=np.stack([mode(family.vertices) for mode in family.modes[: settings.modes]]),
        scores=np.stack([case.scores for case in cases]),
        case_ids=tuple(f"phantom.{number:03d}" for number in range(len(cases))),
        frames=tuple(case.frame for case in cases),
        labels=np.where(family.border < 0, 1, 2),
        seen=np.stack([case.view.holds(case.vertices) for case in cases]),
    )


def scan(family: PhantomFamily, case: Case, noise: float) -> sitk.Image:
    """The case as a label image: 1 and 2, on either side of the family's border."""
    grid = case.view.within(grid_around(case.vertices, case.spacing_mm, case.shift))
    share = occupancy(case.vertices, family.faces, grid)
    generator = np.random.default_rng(case.noise_seed)
    voxels = segmented(share, grid, case.handles, noise, generator)
    return grid.image(two_labels(voxels, grid, case.vertices, family.border))


def _draw_handles(
    family: PhantomFamily,
    vertices: np.ndarray,
    settings: PhantomSettings,
    generator: np.random.Generator,
) -> tuple[Handle, ...]:
    """None, or a bridge over the hilum or a tunnel beneath it."""
    share = family.bridge_share if settings.bridge_share is None else settings.bridge_share
    drawn, is_bridge = generator.random() < share, generator.random() < 0.5
    if not (drawn and len(family.hilum)):
        return ()
    start = vertices[generator.choice(family.hilum)]
    hilum = vertices[family.hilum]
    # To a point of the hilum about eight radii away: short enough to stay there.
    distance = np.linalg.norm(hilum - start, axis=1)
    end = hilum[np.abs(distance - 8 * family.bridge_mm).argmin()]
    middle = (start + end) / 2
    near = cKDTree(vertices).query(middle, k=min(200, len(vertices)))[1]
    inward = vertices.mean(axis=0) - vertices[near].mean(axis=0)
    inward /= np.linalg.norm(inward)
    middle = middle + (-4 if is_bridge else 4) * family.bridge_mm * inward
    return (Handle(np.stack([start, middle, end]), family.bridge_mm, is_bridge),)


def _draw_view(
    family: PhantomFamily,
    vertices: np.ndarray,
    settings: PhantomSettings,
    generator: np.random.Generator,
) -> Slab:
    share = family.cut_share if settings.cut_share is None else settings.cut_share
    is_cut, at_top = generator.random() < share, generator.random() < 0.5
    lost = generator.uniform(*_CUT)
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    if not is_cut:
        return Slab()
    if at_top:
        return Slab(high_mm=float(high - lost * (high - low)))
    return Slab(low_mm=float(low + lost * (high - low)))

"""Masks of solids whose volume and surface are known."""

from collections.abc import Callable

import numpy as np

from ssm_pipeline.records import Mask


def mask_of(
    inside: Callable[[np.ndarray], np.ndarray],
    half_size_mm: float,
    spacing_mm: tuple[float, float, float] = (1.0, 1.0, 1.0),
    direction: np.ndarray | None = None,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Mask:
    """A mask of the voxels whose centres satisfy `inside` ((…, 3) mm LPS, about `centre`)."""
    direction = np.eye(3) if direction is None else direction
    spacing = np.array(spacing_mm)
    count = (2 * np.ceil(half_size_mm / spacing) + 1).astype(int)
    z, y, x = np.meshgrid(*(np.arange(n) for n in count[::-1]), indexing="ij")
    index = np.stack([x, y, z], axis=-1)
    origin = np.array(centre) - direction @ ((count - 1) / 2 * spacing)
    empty = Mask(np.zeros(count[::-1], bool), spacing, origin, direction, "test")
    voxels = inside(empty.to_world(index) - np.array(centre))
    return Mask(voxels, spacing, origin, direction, "test")


def ball(radius: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda points: (points**2).sum(axis=-1) <= radius**2


def torus(ring: float, tube: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda p: (np.hypot(p[..., 0], p[..., 1]) - ring) ** 2 + p[..., 2] ** 2 <= tube**2

"""Still pictures of shapes, off screen: one plotter for a whole set, so the set shares a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyvista as pv

from ssm_pipeline.geometry.surface import vertex_normals

BONE = "#d9cbb4"  # neutral surface colour, light enough for shading to show


@dataclass(frozen=True, eq=False)
class Scene:
    """A shape to draw: vertices (V, 3) mm LPS, faces (F, 3), and what to paint on it.

    values (V,) are drawn through a colour map; colours (V, 3) uint8 as they are; None is plain.
    """

    vertices: np.ndarray
    faces: np.ndarray
    values: np.ndarray | None = None
    colours: np.ndarray | None = None


# Viewing direction and "up", LPS: from the front, from the patient's left, from above.
FRONT = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
LEFT = ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
ABOVE = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
OBLIQUE = ((-0.55, 0.8, -0.2), (0.0, 0.0, 1.0))


def render(
    scenes: Sequence[Scene],
    size_px: int,
    view: tuple[tuple[float, ...], tuple[float, ...]] = OBLIQUE,
    value_range: float = 1.0,
) -> list[np.ndarray]:
    """(H, W, 4) uint8 images on a transparent ground, all at one scale, cropped to what they show.

    size_px: side of the square they are drawn in. value_range: colours from −it to +it.
    """
    centres = [(s.vertices.max(axis=0) + s.vertices.min(axis=0)) / 2 for s in scenes]
    radius = max(
        np.linalg.norm(s.vertices - centre, axis=1).max()
        for s, centre in zip(scenes, centres, strict=True)
    )
    direction, up = np.asarray(view[0]) / np.linalg.norm(view[0]), np.asarray(view[1])
    images = []
    # Without a display VTK tries X first and says so on stderr for every window.
    with pv.vtk_verbosity("off"):
        plotter = pv.Plotter(off_screen=True, window_size=[size_px, size_px], lighting="none")
        try:
            plotter.enable_anti_aliasing("ssaa")
            plotter.enable_parallel_projection()  # type: ignore[call-arg]
            plotter.add_light(pv.Light(light_type="headlight", intensity=0.62))
            # From above left of the viewer: shading shows dents that a headlight alone hides.
            lamp = pv.Light(position=(-0.6, 0.8, 1.0), light_type="camera light", intensity=0.42)
            plotter.add_light(lamp)
            for scene, centre in zip(scenes, centres, strict=True):
                actor = plotter.add_mesh(
                    _surface(scene, centre),
                    scalars=None if scene.values is None and scene.colours is None else "paint",
                    rgb=scene.colours is not None,
                    color=BONE,
                    cmap="RdBu_r",
                    clim=(-value_range, value_range),
                    show_scalar_bar=False,
                    smooth_shading=False,  # our own normals: no vertex is split
                    specular=0.1,
                    render=False,
                    ambient=0.12,
                )
                actor.prop.interpolation = "gouraud"
                plotter.camera.position = tuple(-4 * radius * direction)
                plotter.camera.focal_point = (0.0, 0.0, 0.0)
                plotter.camera.up = tuple(up)
                plotter.camera.parallel_scale = 1.02 * radius
                plotter.reset_camera_clipping_range()
                plotter.render()  # a screenshot alone returns the picture before
                image = plotter.screenshot(return_img=True, transparent_background=True)
                images.append(np.asarray(image))
                plotter.remove_actor(actor, reset_camera=False, render=False)
        finally:
            plotter.close()
    return _crop(images)


def _crop(images: list[np.ndarray]) -> list[np.ndarray]:
    """Cut all to the smallest common rectangle around what is drawn, plus a thin margin."""
    drawn = np.any([image[..., 3] > 0 for image in images], axis=0)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    margin = drawn.shape[0] // 50
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return [image[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1] for image in images]


def _surface(scene: Scene, centre: np.ndarray) -> pv.PolyData:
    surface = pv.PolyData.from_regular_faces(scene.vertices - centre, scene.faces)
    surface.point_data.active_normals = vertex_normals(scene.vertices, scene.faces)
    if scene.values is not None:
        surface.point_data["paint"] = scene.values
    elif scene.colours is not None:
        surface.point_data["paint"] = scene.colours
    result: pv.PolyData = surface
    return result

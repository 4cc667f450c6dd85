from typing import Any

import numpy as np
import torch
from scipy.spatial.distance import cdist
from shapes import basis_of, blob

from ssm_pipeline.matching.hard_map import nearest_features, nearest_rows, projected
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape

SETTINGS = MatchingSettings(features="wks", descriptors=8)


def rows(count: Any, channels: Any, seed: Any) -> Any:
    generator = np.random.default_rng(seed)
    # Of unlike length: by the dot product, the longest would be nearest to most.
    return generator.standard_normal((count, channels)) * generator.uniform(0.1, 5, (count, 1))


def test_the_nearest_row_is_the_nearest_by_distance() -> None:
    queries, keys = rows(70, 5, seed=0), rows(90, 5, seed=1)
    found = nearest_rows(torch.as_tensor(queries), torch.as_tensor(keys), block_rows=32)
    np.testing.assert_array_equal(found, cdist(queries, keys).argmin(axis=1))


def test_the_nearest_feature_has_the_largest_cosine() -> None:
    x, y = rows(40, 6, seed=2), rows(50, 6, seed=3)
    found = nearest_features(torch.as_tensor(x), torch.as_tensor(y))
    np.testing.assert_array_equal(found, cdist(x, y, "cosine").argmin(axis=1))


def test_projection_weighs_vertices_by_their_area() -> None:
    """On a mesh of uneven density Φᵀ alone is no projection: Φᵀ A is."""
    mesh = blob(1, faces=500)
    # Half of the surface is drawn together, so that its vertices have little area.
    vertices = np.where(mesh.vertices[:, :1] > 0, 0.3 * mesh.vertices, mesh.vertices)
    shape_x = to_shape(
        basis_of(type(mesh)(vertices, mesh.faces, "uneven"), 15), SETTINGS, dtype=torch.float64
    )
    shape_y = to_shape(basis_of(mesh, 15), SETTINGS, dtype=torch.float64)
    identity = torch.arange(len(shape_x.vertices))
    torch.testing.assert_close(projected(identity, shape_x, shape_x), identity)
    generator = torch.Generator().manual_seed(0)
    x_to_y = torch.randint(len(shape_y.vertices), (len(shape_x.vertices),), generator=generator)
    Phi_x, Phi_y = shape_x.eigenvectors.numpy(), shape_y.eigenvectors.numpy()
    # Least squares in the area-weighted norm, written out.
    root = np.sqrt(shape_x.mass.numpy())[:, None]
    C_yx = np.linalg.lstsq(root * Phi_x, root * Phi_y[x_to_y.numpy()], rcond=None)[0]
    expected = cdist(Phi_x @ C_yx, Phi_y).argmin(axis=1)
    agree = (projected(x_to_y, shape_x, shape_y).numpy() == expected).mean()
    assert agree > 0.99  # ties of round-off

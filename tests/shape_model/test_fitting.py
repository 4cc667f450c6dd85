import numpy as np
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.fitting import fit
from ssm_pipeline.shape_model.pca import build


def smooth_model():
    """A blob that grows along z and bends: two smooth, large modes."""
    mesh = blob(1)
    x, z = mesh.vertices[:, 0], mesh.vertices[:, 2] / 50
    grow = np.stack([0 * z, 0 * z, 6 * z], axis=1)
    bend = np.stack([5 * z**2, 0 * z, 0.05 * x], axis=1)
    scores = np.random.default_rng(0).standard_normal((12, 2))
    shapes = mesh.vertices + np.einsum("nm,mvd->nvd", scores, np.stack([grow, bend]))
    ids = tuple(f"c{i}" for i in range(12))
    return build(align(CorrespondedShapes(shapes, mesh.faces, ids, "c0"))[0])


def test_an_instance_is_found_again_wherever_it_lies():
    model = smooth_model()
    truth = np.zeros(model.mode_count)
    truth[:2] = [1.2, -0.8]
    pose = Similarity(
        1.0,
        Rotation.from_euler("xyz", [12, -8, 15], degrees=True).as_matrix(),
        np.array([40.0, -20.0, 300.0]),
    )
    # Another triangulation of the instance: no vertex of it is the model's.
    surface = Mesh(pose.apply(model.reconstruct(truth)), model.faces, "new")
    finer = surface.vertices[surface.faces].mean(axis=1)
    corner = len(surface.vertices) + np.arange(len(finer))
    split = [np.column_stack([surface.faces[:, [i, (i + 1) % 3]], corner]) for i in range(3)]
    surface = Mesh(np.concatenate([surface.vertices, finer]), np.concatenate(split), "new")
    found = fit(model, surface, noise_mm=0.1, steps=300, tolerance=1e-6)
    # Nearest points slide: convergence is slow along the surface, the fit itself is tight.
    assert found.distances_mm.mean() < 0.15
    np.testing.assert_allclose(found.scores[:2], truth[:2], atol=0.15)
    np.testing.assert_allclose(
        found.frame.apply(model.reconstruct(found.scores)), found.vertices, atol=1e-9
    )


def test_more_noise_keeps_the_fit_nearer_the_mean():
    model = smooth_model()
    surface = Mesh(model.reconstruct([2.0, 0.0]), model.faces, "new")
    loose, tight = (np.linalg.norm(fit(model, surface, noise).scores) for noise in (200.0, 0.1))
    assert loose < 0.7 * tight

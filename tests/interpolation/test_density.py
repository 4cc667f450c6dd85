"""A weight means the same at any density: the loss of a pair, remeshed finer, is the same."""

from typing import Any, cast

import pymeshlab
import pytest
import torch
from shapes import basis_of, blob

from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.settings import SpatialLossSettings
from ssm_pipeline.interpolation.spatial_loss import spatial_loss
from ssm_pipeline.matching.pair import match_pair
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape
from ssm_pipeline.records import Mesh

MATCHING = MatchingSettings(features="wks", descriptors=8)


class Wave(torch.nn.Module):
    """A smooth movement that is a function of the place alone, so the same at any density."""

    def forward(self, vertices: Any, target: Any, times: Any, neighbours: Any) -> Any:
        wave = torch.sin(2 * vertices.flip(1)) * 0.2
        return vertices + times[:, None, None] * wave


def isotropic(mesh: Mesh, edge_mm: float) -> Mesh:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PureValue(edge_mm), iterations=8
    )
    done = meshes.current_mesh()
    return Mesh(done.vertex_matrix(), done.face_matrix(), mesh.case_id)


def terms(edge_mm: float) -> tuple[int, dict[str, float]]:
    shapes = [
        to_shape(basis_of(isotropic(blob(seed, faces=5000), edge_mm), 20), MATCHING)
        for seed in (1, 2)
    ]
    # Features that are functions of the place: what a trained network gives at either density.
    features = [torch.sin(torch.cat([5 * s.vertices, 9 * s.vertices], 1)) for s in shapes]
    pair = match_pair(shapes[0], shapes[1], features[0], features[1], MATCHING)
    found = spatial_loss(pair, cast(Interpolator, Wave()), 3, SpatialLossSettings())
    return len(shapes[0].vertices), {name: float(term.detach()) for name, term in found.items()}


def test_terms_do_not_move_with_the_mesh() -> None:
    count, coarse = terms(6.0)
    middle_count, middle = terms(4.3)
    fine_count, fine = terms(2.2)
    assert count < 550 < 900 < middle_count < 1100 < 3500 < fine_count
    assert set(coarse) == {"align", "arap", "symmetry", "variance", "dirichlet"}
    # Linear elements converge with the square of the edge: what is left is that, and the energy of
    # bending within a ring. Vertex sums without weights would differ eightfold.
    for name, value in fine.items():
        assert coarse[name] == pytest.approx(value, rel=0.03), name
        assert middle[name] == pytest.approx(value, rel=0.02), name

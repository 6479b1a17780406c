"""Interpolation at points, compared with point location in Qhull's triangulation."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points


@pytest.fixture(scope="module")
def cloud():
    nodes = np.random.default_rng(4).uniform(-20, 20, (400, 3))
    return Delaunay(nodes)


@pytest.fixture(scope="module")
def mesh(cloud):
    tets = cloud.simplices.astype(np.int32)
    corner = cloud.points[tets]
    turned = np.linalg.det(corner[:, 1:] - corner[:, :1]) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return TetMesh(cloud.points, tets)


def test_values_match_qhull_point_location(cloud, mesh):
    points = np.random.default_rng(5).uniform(-12, 12, (500, 3))
    values = np.sin(mesh.nodes / 5)
    simplex = cloud.find_simplex(points)
    transform = cloud.transform[simplex]
    weight = np.einsum("pij,pj->pi", transform[:, :3], points - transform[:, 3])
    weight = np.column_stack([weight, 1 - weight.sum(axis=1)])
    expected = np.einsum("pc,pcx->px", weight, values[cloud.simplices[simplex]])
    matrix = interpolation_at_points(mesh, points)
    assert matrix.shape == (500, 400) and matrix.nnz <= 4 * 500
    np.testing.assert_allclose(matrix @ values, expected, atol=1e-9)


def test_points_slightly_outside_are_extrapolated_linearly(mesh):
    centre = mesh.nodes.mean(axis=0)
    rim = mesh.nodes[np.argsort(-np.linalg.norm(mesh.nodes, axis=1))[:20]]
    points = rim + 0.1 * (rim - centre) / np.linalg.norm(rim - centre, axis=1, keepdims=True)
    matrix = interpolation_at_points(mesh, points)
    np.testing.assert_allclose(matrix.sum(axis=1), 1)
    assert np.median(np.linalg.norm(matrix @ mesh.nodes - points, axis=1)) < 1e-9


def test_refuses_points_of_another_body(mesh):
    with pytest.raises(InputError, match="1 of 2 points are more than 5 mm outside the mesh"):
        interpolation_at_points(mesh, np.array([(0.0, 0.0, 0.0), (90.0, 0.0, 0.0)]))
    with pytest.raises(InputError, match="finite"):
        interpolation_at_points(mesh, np.array([(0.0, np.inf, 0.0)]))

"""Interpolation between levels: exact inside, bounded outside."""

import numpy as np
import pytest

from palpate.storage.values import TetMesh
from palpate.workers.body.mesh.nodal_interpolation import FARTHEST, prolongation

NONE = np.empty(0, np.int32)


def pairs(meshes):
    return list(zip(meshes.levels[:-1], meshes.levels[1:], strict=True))


def test_rows_sum_to_one_and_fit_the_levels(meshes):
    assert meshes.levels[0].prolongation is None
    for coarse, fine in pairs(meshes):
        matrix = fine.prolongation
        assert matrix.shape == (len(fine.mesh.nodes), len(coarse.mesh.nodes))
        assert matrix.dtype == np.float64
        np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-12)
        assert abs(matrix).max() < 2


def test_linear_functions_are_reproduced(meshes):
    slope = np.array([(1.0, 2.0, -3.0), (0.5, 0.0, 1.0)]).T
    for coarse, fine in pairs(meshes):
        computed = fine.prolongation @ (coarse.mesh.nodes @ slope + 7)
        np.testing.assert_allclose(computed, fine.mesh.nodes @ slope + 7, atol=1e-9)


def test_error_of_a_quadratic_is_bounded_by_the_cell_size(meshes):
    # Interpolating x^2 linearly errs by at most R^2, R the radius of the smallest sphere around
    # the cell: a / sqrt 2 for the half squares of the wall. Nodes were moved by a quarter of a cell
    # at most and some are outside, hence 1.5. A coarse level has cells twice as large.
    for step, (coarse, fine) in enumerate(reversed(pairs(meshes)), start=1):
        error = fine.prolongation @ coarse.mesh.nodes[:, 0] ** 2 - fine.mesh.nodes[:, 0] ** 2
        limit = (meshes.element_size_mm * 2**step) ** 2 / 2
        assert 0.05 * limit < np.abs(error).max() < 1.5 * limit


def test_wall_nodes_interpolate_only_wall_nodes(meshes):
    for coarse, fine in pairs(meshes):
        value = np.random.default_rng(3).standard_normal(len(coarse.mesh.nodes))
        value[coarse.wall] = 0
        assert not (fine.prolongation @ value)[fine.wall].any()


def test_extrapolation_is_bounded():
    corner = TetMesh(np.eye(4, 3, k=-1), np.array([[0, 1, 2, 3]], np.int32))
    points = np.array([(0.25, 0.25, 0.25), (-0.1, 0.2, 0.2), (-5.0, 0.2, 0.2)])
    weights = prolongation(corner, NONE, points, NONE).toarray()
    np.testing.assert_allclose(weights[0], 0.25)
    np.testing.assert_allclose(weights[1], (0.7, -0.1, 0.2, 0.2))
    # Weights (5.6, -5, 0.2, 0.2) are clipped at -FARTHEST and scaled to the sum 1.
    total = 5.6 - FARTHEST + 0.4
    np.testing.assert_allclose(weights[2], np.array([5.6, -FARTHEST, 0.2, 0.2]) / total)
    assert weights[2].sum() == pytest.approx(1)

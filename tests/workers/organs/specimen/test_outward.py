"""Normals of a surface and arms on it."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.organs.specimen.block_lattice import lattice
from palpate.workers.organs.specimen.specimen_body import (
    arms,
    distances_to_triangles,
    outward_normals,
)

SIZE = (12.0, 10.0, 20.0)
MESH = lattice(SIZE, (4, 4, 7))
FACES = boundary_triangles(MESH.tets)


def normals_at(points, stated=None):
    names = [str(n) for n in range(len(points))]
    stated = stated or [None] * len(points)
    return outward_normals(MESH.nodes, FACES, np.array(points), stated, names)


def test_distance_from_a_triangle_matches_hand_calculation():
    r"""Worked out by hand.

    ::

        (0,3) +
              | \\
              |   \\
        (0,0) +-----+ (4,0)
    """
    corners = np.array([[[0, 0, 0], [4, 0, 0], [0, 3, 0]]], float)
    for point, expected in [
        ((1, 1, 2), 2.0),  # above it
        ((5, 0, 0), 1.0),  # beyond a corner
        ((2, -3, 0), 3.0),  # next to an edge
        ((4, 3, 0), 12 / 5),  # next to the hypotenuse
        ((-3, -4, 12), 13.0),
    ]:
        found = distances_to_triangles(np.array(point, float), corners)
        assert found[0] == pytest.approx(expected)


def test_normals_of_block_faces_point_outwards():
    found = normals_at([(5, 10, 9), (0.0, 4.5, 3), (5, 10.4, 9), (4, 4, 20)])
    np.testing.assert_allclose(found, [(0, 1, 0), (-1, 0, 0), (0, 1, 0), (0, 0, 1)], atol=1e-12)


def test_marker_on_an_edge_needs_a_direction():
    with pytest.raises(InputError, match="marker 0 is on an edge"):
        normals_at([(5.0, 10.0, 20.0)])
    found = normals_at([(5.0, 10.0, 20.0)], [(0, 3, 4)])
    np.testing.assert_allclose(found, [(0, 0.6, 0.8)])


def test_arms_rotate_with_the_body():
    """Under x -> G x + t the end of an arm n moves by (G - I) n relative to its foot."""
    rng = np.random.default_rng(1)
    feet = np.array([(6, 10, 20), (0, 4, 13), (7, 10, 6)], float)
    out = [(0.0, 1.0, 0.0), None, None]
    matrix = arms(MESH, feet, out, ["a", "b", "c"])
    G = np.eye(3) + 0.4 * rng.standard_normal((3, 3))
    u = MESH.nodes @ G.T + [3, 4, 5] - MESH.nodes
    normals = np.array([(0, 1, 0), (-1, 0, 0), (0, 1, 0)], float)
    np.testing.assert_allclose(matrix @ u, normals @ (G - np.eye(3)).T, atol=1e-10)

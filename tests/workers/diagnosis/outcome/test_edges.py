"""A block has its twelve edges drawn; a ball has none."""

import numpy as np
import pytest

from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.diagnosis.outcome.body_pictures import edge_arrays, sharp_edges
from palpate.workers.organs.specimen.block_lattice import block

SIZE_MM = (30.0, 20.0, 60.0)


def test_edges_of_a_block_at_rest_and_deformed() -> None:
    mesh = block(SIZE_MM, 1000).finest.mesh
    moved = mesh.nodes * [0.0, 0.1, -0.2]
    found = edge_arrays(
        mesh.nodes,
        sharp_edges(mesh.nodes, boundary_triangles(mesh.tets)),
        {"before": [moved], "after": [moved[:-1]]},
    )
    ends = found["edges_rest"]
    on_sides = (np.isclose(ends, 0) | np.isclose(ends, SIZE_MM)).sum(axis=2)
    assert (on_sides >= 2).all()
    assert np.linalg.norm(np.diff(ends, axis=1), axis=2).sum() == pytest.approx(4 * sum(SIZE_MM))
    np.testing.assert_allclose(found["edges_before"][0], ends * [1.0, 1.1, 0.8])
    assert "edges_after" not in found  # of another mesh


def test_a_round_body_has_no_sharp_edge() -> None:
    """The block's surface is inflated to a ball, on which neighbours bend by some 20 degrees."""
    mesh = block((2.0, 2.0, 2.0), 2000).finest.mesh
    triangles = boundary_triangles(mesh.tets)
    centred = mesh.nodes - 1.0
    ball = centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-9)
    assert len(sharp_edges(mesh.nodes, triangles)) > 12
    assert len(sharp_edges(ball, triangles)) == 0

"""Surfaces displaced with the quadratic displacement of the mesh."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import generated_section

SECTION = generated_section()
MESH = mesh_section(SECTION, 240, (-1.5, 1.5))


def test_zero_displacement_gives_points_of_the_section() -> None:
    same = deformed_section(SECTION, MESH, np.zeros_like(MESH.nodes_mm))
    for surface, own in (
        (same.anterior_mm, SECTION.anterior_mm),
        (same.posterior_mm, SECTION.posterior_mm),
    ):
        assert np.allclose(np.interp(surface[:, 0], *own.T), surface[:, 1], atol=1e-12)
        assert np.array_equal(surface[[0, -1]], own[[0, -1]])


def test_a_rigid_motion_moves_the_surfaces_rigidly() -> None:
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    moved = deformed_section(SECTION, MESH, MESH.nodes_mm @ (turn.T - np.eye(2)) + [0.3, -0.2])
    rest = deformed_section(SECTION, MESH, np.zeros_like(MESH.nodes_mm))
    # The displacement of points between nodes is interpolated along the arc: h^3 of 0.1 rad.
    assert np.allclose(moved.anterior_mm, rest.anterior_mm @ turn.T + [0.3, -0.2], atol=2e-6)
    assert np.allclose(moved.posterior_mm, rest.posterior_mm @ turn.T + [0.3, -0.2], atol=2e-6)


def test_smooth_displacement_converges_with_order_three() -> None:
    errors = []
    for elements in (60, 240, 960):
        mesh = mesh_section(SECTION, elements)
        u = np.column_stack([0 * mesh.nodes_mm[:, 0], -np.exp(-(mesh.nodes_mm[:, 0] ** 2) / 4)])
        moved = deformed_section(SECTION, mesh, u).anterior_mm
        exact = np.interp(moved[:, 0], *SECTION.anterior_mm.T) - np.exp(-(moved[:, 0] ** 2) / 4)
        errors.append(np.abs(moved[:, 1] - exact).max())
    # From one mesh to the next the sides are half as long.
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 2.5)


def test_rejects_the_displacement_of_another_mesh() -> None:
    with pytest.raises(InputError, match="does not match a mesh"):
        deformed_section(SECTION, MESH, np.zeros((3, 2)))

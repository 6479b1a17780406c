"""Lattices of a block: exact volume and surface, nested meshes and bending."""

from itertools import pairwise

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box, DeadForce, Hold, NoPlates, Wall
from palpate.workers.organs.specimen.block_lattice import MOST_FACTORED, block, cells_of, lattice
from palpate.workers.organs.specimen.mesh_and_boundary_errors import part_of_compliance

SIZE = (20.0, 16.0, 50.0)


@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 3, 4), (5, 4, 7)])
def test_lattice_has_volume_and_area_of_the_block(cells):
    mesh = lattice(SIZE, cells)
    corners = mesh.nodes[mesh.tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(np.prod(SIZE), rel=1e-12)
    a, b, c = mesh.nodes[boundary_triangles(mesh.tets)].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    x, y, z = SIZE
    assert area == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-12)


def test_prolongation_is_exact_for_linear_fields():
    levels = block(SIZE, 3000, Tissue.MUSCLE).levels
    assert len(levels) >= 2
    for coarse, fine in pairwise(levels):
        carried = fine.prolongation @ coarse.mesh.nodes
        np.testing.assert_allclose(carried, fine.mesh.nodes, atol=1e-9)
        assert not (fine.prolongation[fine.wall] @ coarse.mesh.nodes)[:, 2].any()
    assert (levels[-1].fractions[:, Tissue.MUSCLE] == 1).all()


@pytest.mark.parametrize("nodes", [1000, 5000, 20000])
def test_mesh_has_the_requested_number_of_nodes(nodes):
    assert len(lattice(SIZE, cells_of(SIZE, nodes)).nodes) == pytest.approx(nodes, rel=0.2)


def test_rejects_too_few_nodes_for_bending():
    with pytest.raises(InputError, match="shortest side needs 4 elements"):
        block((30.0, 30.0, 100.0), 100)


def test_plate_of_four_cells_has_a_coarser_level():
    """Only the cells along its long sides are halved, and the energy is as expected."""
    size = (40.0, 40.0, 10.0)
    hierarchy = block(size, 2300)
    counts = [len(level.mesh.nodes) for level in hierarchy.levels]
    assert counts[0] <= MOST_FACTORED < counts[-1]
    ends = [Box((x, -1, -1), (x + 0.01, 41, 11)) for x in (-0.005, 39.995)]
    holds = (Hold(ends[0]), Hold(ends[1], (2.0, 0.0, 1.0)))
    stretched = Problem(
        {Tissue.FAT: Constants(0.1, 0.45)},
        NoPlates(),
        wall=Wall((False, False, False)),
        holds=holds,
    )
    outcome = solve(prepare(hierarchy), stretched).outcome
    assert outcome.converged
    assert max(outcome.cg_iterations[1:]) < 40
    # Far from its ends it narrows like a bar; E A eps^2 L / 2 is a lower bound.
    assert 0.1 * 400 * 0.05**2 * 40 / 2 < outcome.energy_mj < 2 * 0.1 * 400 * 0.05**2 * 40 / 2


def test_suggests_a_sheet_for_a_thin_block():
    with pytest.raises(InputError, match=r"sheet: \{size_mm: \[100, 80\], thickness_mm: 0.5\}"):
        block((100.0, 80.0, 0.5), 20000)


# A beam of Euler, Bernoulli and Timoshenko: w = F L^3 / 3 E I + F L / (5/6) G A. With
# nu = 0 the clamp does not restrict contraction of the section, and the theory holds.
LENGTH, HEIGHT, YOUNG, FORCE = 80.0, 16.0, 0.25, 1e-4
TIP = np.array([[HEIGHT / 2, HEIGHT / 2, LENGTH]])


def cantilever():
    tip = Box((-1, -1, LENGTH - 1e-3), (HEIGHT + 1, HEIGHT + 1, LENGTH + 1e-3))
    return Problem(
        {Tissue.FAT: Constants(YOUNG, 1e-6)},
        NoPlates(),
        wall=Wall((True, True, True)),
        forces=(DeadForce((0.0, -FORCE, 0.0), tip),),
        tolerance_mm=1e-7,
    )


def test_corrected_deflection_matches_beam_theory():
    inertia, area = HEIGHT**4 / 12, HEIGHT**2
    expected = FORCE * LENGTH**3 / (3 * YOUNG * inertia) + FORCE * LENGTH / (
        5 / 6 * YOUNG / 2 * area
    )
    size = (HEIGHT, HEIGHT, LENGTH)
    hierarchy = block(size, 2400)
    u = interpolation_at_points(hierarchy.finest.mesh, TIP) @ (
        solve(prepare(hierarchy), cantilever()).displacement_mm
    )
    part = part_of_compliance(size, 2400, TIP, cantilever())
    assert -u[0, 1] / expected < 0.985  # the mesh alone is too stiff
    assert -u[0, 1] / part == pytest.approx(expected, rel=0.008)

"""Octrees are balanced and their tetrahedra fill space without hanging nodes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.body.mesh.adaptive_lattice import GradedLattice, graded_lattice, graded_levels
from palpate.workers.body.mesh.mesh_geometry import (
    boundary_triangles,
    measures,
    triangle_areas_mm2,
    volumes_mm3,
)

CELL_MM = 0.5
CORNER = np.array([1.0, -2.0, 3.0])


def scattered(seed: int, top: int = 3) -> NDArray[np.uint8]:
    """Return largest levels with small cells at random places, including the borders."""
    rng = np.random.default_rng(seed)
    largest = np.full((16, 24, 32), top, np.uint8)
    largest[rng.random(largest.shape) < 1e-3] = 0
    largest[0, 5, 9] = 0
    return largest


def lattice_of(seed: int) -> GradedLattice:
    return graded_lattice(graded_levels(scattered(seed)), CORNER, CELL_MM)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_leaves_are_aligned_balanced_and_no_larger_than_allowed(seed: int) -> None:
    largest = scattered(seed)
    levels = graded_levels(largest)
    assert (levels <= largest).all()
    assert set(np.unique(levels)) >= {0, 1}
    padded = np.pad(levels.astype(int), 1, mode="edge")
    for shift in np.ndindex(3, 3, 3):
        window = tuple(slice(s, s + n) for s, n in zip(shift, levels.shape, strict=True))
        assert np.abs(padded[window] - levels).max() <= 1, shift
    for level in range(1, int(levels.max()) + 1):
        size = 2**level
        at = np.argwhere(levels == level)
        for z, y, x in np.unique(at // size, axis=0) * size:
            assert (levels[z : z + size, y : y + size, x : x + size] == level).all()


def test_small_cell_is_surrounded_by_leaves_of_the_next_level() -> None:
    largest = np.full((32, 32, 32), 2, np.uint8)
    largest[16, 16, 16] = 0
    line = graded_levels(largest)[16, 16]
    # On either side of the eight smallest ones.
    assert np.count_nonzero(line == 1) >= 4
    assert line[0] == line[-1] == 2


def test_refuses_sides_that_do_not_fit() -> None:
    with pytest.raises(InputError, match="multiples of 4"):
        graded_levels(np.full((6, 8, 8), 2, np.uint8))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_has_no_hanging_nodes(seed: int) -> None:
    """Faces without a partner are only on the wall or next to the outermost centres."""
    lattice = lattice_of(seed)
    mesh = lattice.mesh
    triangles = boundary_triangles(mesh.tets)
    x = mesh.nodes[triangles]
    low = CORNER
    high = low + CELL_MM * np.array([32, 24, 16])
    wall = (x[..., 2] == low[2]).all(axis=1)
    assert triangle_areas_mm2(mesh.nodes, triangles[wall]).sum() == pytest.approx(16 * 12)
    # Outer pyramids are missing, at most as deep as half of the largest leaves.
    rim = CELL_MM * 8 / 2 + 1e-9
    near = (x.mean(axis=1) - low < rim) | (high - x.mean(axis=1) < rim)
    near[:, 2] = (high - x.mean(axis=1))[:, 2] < rim
    assert (wall | near.any(axis=1)).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tetrahedra_fill_their_boundary_and_have_known_shapes(seed: int) -> None:
    lattice = lattice_of(seed)
    volumes = volumes_mm3(lattice.mesh)
    assert volumes.min() > 0
    # Divergence theorem: the tetrahedra fill exactly what their boundary encloses.
    x = lattice.mesh.nodes[boundary_triangles(lattice.mesh.tets)]
    enclosed = np.einsum("ki,ki->k", x[:, 0], np.cross(x[:, 1], x[:, 2])).sum() / 6
    assert volumes.sum() == pytest.approx(enclosed)
    aspect = measures(lattice.mesh)["aspect"]
    # The lattice's own 1.1547; half pyramids and halves are the worst, 2 sqrt(2) / 1.2247.
    assert aspect.min() == pytest.approx(np.sqrt(4 / 3))
    assert aspect.max() == pytest.approx(2 * np.sqrt(2) / np.sqrt(1.5))


def test_equal_leaves_give_the_uniform_lattice() -> None:
    lattice = graded_lattice(np.zeros((4, 5, 6), np.uint8), CORNER, CELL_MM)
    corners = len(np.unique(lattice.mesh.tets))
    assert corners == len(lattice.mesh.nodes)
    inner = np.isclose(volumes_mm3(lattice.mesh), CELL_MM**3 / 12)
    # The pyramids on the wall are halved: as large as the others.
    assert inner.all()
    assert (lattice.size_mm == CELL_MM).all()

"""Cell sizes, the position of the level set, and the effect of smoothing."""

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.adaptive_cuts import level_set_of
from palpate.workers.body.mesh.adaptive_lattice import Sizes, cell_levels
from palpate.workers.body.mesh.adaptive_mesher import _cut_lattice, smoothed
from palpate.workers.body.mesh.body_outline import distance_at, outline_of
from palpate.workers.body.mesh.mesh_geometry import measures


def blocks() -> Volume:
    """Return gland in two halves with a gap of two voxels, in a block of fat.

    ::

        z = 24  f f f f f f f f
                f g g g   g g f     the gap is 1 mm wide, the halves are 7 mm
                f g g g   g g f
        z = 0   f g g g   g g f
    """
    values = np.full((48, 48, 64), Tissue.FAT, np.uint8)
    values[:32, 16:32, 16:30] = Tissue.GLANDULAR
    values[:32, 16:32, 32:46] = Tissue.GLANDULAR
    return Volume(values, (0.5, 0.5, 0.5), (0.25, 0.25, 0.25))


def test_cells_are_smallest_at_the_surface_of_the_tissue() -> None:
    labels = blocks()
    sizes = Sizes(0.5, skin_mm=4.0, largest_mm=4.0)
    levels, corner = cell_levels(labels, Tissue.GLANDULAR, outline_of(labels, 0.5), sizes)

    def at(x: float, y: float, z: float) -> int:
        i, j, k = ((np.array([x, y, z]) - corner) / 0.5).astype(int)
        return int(levels[k, j, i])

    assert at(15.5, 12.0, 8.0) == at(8.1, 12.0, 8.0) == 0  # in the gap, at a far side
    assert at(2.0, 2.0, 22.0) >= 2  # in fat


def test_level_set_is_the_distance_to_a_plane() -> None:
    labels = blocks()
    surface = level_set_of(labels, Tissue.GLANDULAR)
    assert surface.volume_mm3 == pytest.approx(2 * 7 * 8 * 16)
    for away in (-0.4, -0.1, 0.0, 0.2, 0.4):
        # Near the plane y = 16 mm, far from edges; it continues straight across the wall.
        for z in (0.3, 8.0):
            found = distance_at(surface.field, surface.frame, 11.5, 16.0 + away, z)
            assert found == pytest.approx(away, abs=1e-3 + 0.2 * max(abs(away) - 0.25, 0))


def test_smoothing_improves_the_sum_and_keeps_surfaces() -> None:
    labels = blocks()
    outline = outline_of(labels, 0.5)
    inner = level_set_of(labels, Tissue.GLANDULAR)
    mesh, _, held = _cut_lattice(labels, Tissue.GLANDULAR, outline, Sizes(1.5), inner)
    after = smoothed(mesh, held, 3)
    before_m3, after_m3 = (measures(m)["M3"] for m in (mesh, after))
    assert after_m3.min() > 0
    assert (after_m3**-3).sum() < 0.95 * (before_m3**-3).sum()
    assert np.array_equal(after.nodes[held.on_wall, 2], mesh.nodes[held.on_wall, 2])
    both = held.on_skin & held.on_interface
    assert np.array_equal(after.nodes[both], mesh.nodes[both])
    moved = held.on_interface & (after.nodes != mesh.nodes).any(axis=1)
    assert moved.sum() > 50
    field = np.array([distance_at(inner.field, inner.frame, *p) for p in after.nodes[moved]])
    assert np.abs(field).max() < 0.02

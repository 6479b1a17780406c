"""Skin that compression thins below a voxel stays closed; nothing else changes."""

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.surface_layer import warp_with_skin
from palpate.workers.comparison.warp_volume import warp_labels
from tests.workers.comparison.kuhn_mesh import box_mesh

SHAPE = (9, 20, 12)


def block(**tissues) -> Volume:
    """Return fat between two sheets of skin, one voxel thick, at both ends of y."""
    values = np.full(SHAPE, Tissue.FAT, np.uint8)
    values[:, [0, -1]] = Tissue.SKIN
    for name, place in tissues.items():
        values[place] = Tissue[name]
    return Volume(values, (1.0, 1.0, 1.0), (0.5, 0.5, 0.5))


def squeezed(mesh, ratio: float, shift_mm: float = 0.0):
    """Return a displacement that shortens y to `ratio` and shifts it."""
    displacement = np.zeros_like(mesh.nodes)
    displacement[:, 1] = (ratio - 1) * mesh.nodes[:, 1] + shift_mm
    return displacement


MESH = box_mesh((3, 4, 3), (0, 0, 0), SHAPE[::-1], jitter=0.2)


@pytest.mark.parametrize("shift_mm", [0.0, 0.2, 0.45, 0.7])
@pytest.mark.parametrize("ratio", [0.3, 0.45, 0.8])
def test_squeezed_skin_is_closed(ratio, shift_mm):
    """The sheet is 0.3 to 0.8 mm thick, wherever the voxel centres are."""
    u = squeezed(MESH, ratio, shift_mm)
    plain, whole = (warp(block(), MESH, u).values for warp in (warp_labels, warp_with_skin))
    for end in (0, -1):
        assert (whole[:, end] == Tissue.SKIN).all()
    changed = whole != plain
    assert (plain[changed] == Tissue.FAT).all()
    assert not changed[:, 1:-1].any()


def test_plain_image_has_holes():
    """Without closing, no voxel centre is in the first sheet of skin."""
    plain = warp_labels(block(), MESH, squeezed(MESH, 0.3, 0.15)).values
    assert (plain[:, 0] == Tissue.FAT).all()


def test_glandular_tissue_at_the_surface_stays():
    body = block(GLANDULAR=np.s_[2:5, 1:4, 3:6])
    u = squeezed(MESH, 0.3, 0.15)
    plain, whole = (warp(body, MESH, u).values for warp in (warp_labels, warp_with_skin))
    np.testing.assert_array_equal(whole == Tissue.GLANDULAR, plain == Tissue.GLANDULAR)
    assert (plain[:, 0] == Tissue.GLANDULAR).any()


def test_body_without_skin_is_unchanged():
    """No skin is added to cut sides, a region without skin, or a body at rest."""
    bare = block(FAT=np.s_[:, 0, :6])
    u = squeezed(MESH, 0.3, 0.15)
    whole = warp_with_skin(bare, MESH, u).values
    assert (whole[:, 0, :5] == Tissue.FAT).all()
    assert (whole[:, 0, 7:] == Tissue.SKIN).all()
    at_rest = warp_with_skin(block(), MESH, np.zeros_like(MESH.nodes)).values
    np.testing.assert_array_equal(at_rest, block().values)
    naked = block(FAT=np.s_[:])
    np.testing.assert_array_equal(
        warp_with_skin(naked, MESH, u).values, warp_labels(naked, MESH, u).values
    )

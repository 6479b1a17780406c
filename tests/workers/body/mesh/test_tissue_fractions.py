"""Votes and volume fractions on small volumes, with known counts."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh, Tissue, Volume
from palpate.workers.body.mesh.mesh_geometry import volumes_mm3
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.mesh.tissue_fractions import majority_fractions, volume_fractions

AIR, FAT, GLAND, LIGAMENT = Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR, Tissue.LIGAMENT


def voted(at_nodes, at_centroid, elsewhere=AIR):
    """Return the tissue of a tetrahedron over 9^3 voxels of 1 mm, labelled at its five points."""
    nodes = np.array([(0.5, 0.5, 0.5), (8.5, 0.5, 0.5), (0.5, 8.5, 0.5), (0.5, 0.5, 8.5)])
    labels = np.full((9, 9, 9), elsewhere, np.uint8)
    for point, label in zip([*nodes, nodes.mean(axis=0)], [*at_nodes, at_centroid], strict=True):
        i, j, k = point.astype(int)
        labels[k, j, i] = label
    mesh = TetMesh(nodes, np.array([[0, 1, 2, 3]], np.int32))
    row = majority_fractions(mesh, Volume(labels, (1, 1, 1), (0.5, 0.5, 0.5)))[0]
    assert row.sum() == 1 and row.max() == 1
    return Tissue(int(row.argmax()))


@pytest.mark.parametrize(
    ("at_nodes", "at_centroid", "tissue"),
    [
        ((FAT, FAT, FAT, GLAND), GLAND, FAT),  # 3 to 2
        ((FAT, FAT, GLAND, GLAND), GLAND, GLAND),  # 2 to 3
        ((AIR, AIR, AIR, AIR), GLAND, GLAND),  # air has no vote
        ((AIR, AIR, AIR, LIGAMENT), AIR, LIGAMENT),
        ((FAT, FAT, GLAND, AIR), GLAND, GLAND),  # 2 to 2: the centroid's
        ((FAT, GLAND, AIR, AIR), AIR, FAT),  # 1 to 1, nothing at the centroid: the lower label
        ((LIGAMENT, FAT, GLAND, GLAND), FAT, FAT),  # 2 to 2 to 1
        ((FAT, FAT, GLAND, GLAND), LIGAMENT, FAT),  # 2 to 2 to 1, the centroid not among the first
    ],
)
def test_five_points_vote_for_the_tissue(at_nodes, at_centroid, tissue):
    assert voted(at_nodes, at_centroid) == tissue


def test_tetrahedron_in_air_gets_the_nearest_tissue():
    assert voted((AIR,) * 4, AIR, elsewhere=GLAND) == GLAND
    assert voted((AIR,) * 4, AIR) == FAT


def test_fractions_of_two_layers_match_their_volumes(breast):
    # Half ellipsoid cut at z = h: the volume below is pi a b (h - h^3 / (3 c^2)).
    values = breast.values.copy()
    height = 20.0
    z = breast.origin_mm[2] + np.arange(len(values)) * breast.spacing_mm[2]
    values[z > height] *= np.uint8(GLAND)
    below = np.pi * 85 * 50 * (height - height**3 / (3 * 50**2))
    above = 2 / 3 * np.pi * 85 * 50 * 50 - below
    meshes = build_hierarchy(Volume(values, breast.spacing_mm, breast.origin_mm), nodes=5000)
    for level in meshes.levels:
        fractions = level.fractions.astype(float)
        assert level.fractions.dtype == np.float32
        np.testing.assert_allclose(fractions.sum(axis=1), 1, atol=1e-6)
        parts = volumes_mm3(level.mesh) @ fractions
        assert parts[FAT] == pytest.approx(below, rel=0.02)
        assert parts[GLAND] == pytest.approx(above, rel=0.02)
        assert parts[[AIR, Tissue.SKIN, Tissue.MUSCLE, LIGAMENT]].sum() == 0
    assert set(np.unique(meshes.finest.fractions)) == {0, 1}
    mixed = (meshes.levels[0].fractions.max(axis=1) < 1).mean()
    assert mixed > 0.1  # the coarse cells do straddle the interface


def test_cut_tetrahedron_is_sampled_in_proportion():
    # The corner of a cube of 20 mm, cut at z = 8: above remains (1 - 8/20)^3 of it.
    nodes = np.array([(0, 0, 0), (20, 0, 0), (0, 20, 0), (0, 0, 20)], float)
    mesh = TetMesh(nodes, np.array([[0, 1, 2, 3]], np.int32))
    labels = np.full((20, 20, 20), FAT, np.uint8)
    labels[8:] = LIGAMENT
    row = volume_fractions(mesh, Volume(labels, (1, 1, 1), (0.5, 0.5, 0.5)))[0]
    assert row[LIGAMENT] == pytest.approx(0.6**3, abs=0.02)
    assert row[FAT] + row[LIGAMENT] == pytest.approx(1)


def cut_along(labels_of, origin=(0.5, 0.5, 0.5)):
    """Return the fractions of the tetrahedron of `NODES` over voxels of 0.5 x 0.25 x 1 mm."""
    spacing = (0.5, 0.25, 1.0)
    k, j, i = np.meshgrid(*(np.arange(n) for n in (16, 48, 40)), indexing="ij")
    x, y, z = (o + n * h for o, n, h in zip(origin, (i, j, k), spacing, strict=True))
    labels = np.where(labels_of(x, y, z), GLAND, FAT).astype(np.uint8)
    nodes = np.array([(3, 2, 1), (15, 2, 1), (3, 10, 1), (3, 2, 13)], float)
    mesh = TetMesh(nodes, np.array([[0, 1, 2, 3]], np.int32))
    return volume_fractions(mesh, Volume(labels, spacing, origin))[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("part", [0.25, 0.5])
def test_interface_normal_to_an_axis_leaves_the_tip_of_a_tetrahedron(axis, part):
    r"""A plane across each leg of a right-angled tetrahedron, at a different position on each.

    ::

        leg from c to c + l, tissue beyond the plane at c + part l:

            |\
            | \          the tip is the whole one scaled by 1 - part,
        ----|--\----     so it has (1 - part)^3 of its volume
            |   \
            |____\

    The legs are 12, 8 and 12 mm long and start at x = 3, y = 2 and z = 1 mm, voxels are
    0.5 x 0.25 x 1 mm: swapped axes, a flipped sign or a corner that is off by a voxel give
    another fraction. Every plane is a face between voxels.
    """
    start, length = (3.0, 2.0, 1.0)[axis], (12.0, 8.0, 12.0)[axis]
    origin = (-0.25, -0.125, 0.5)
    row = cut_along(lambda *xyz: xyz[axis] > start + part * length, origin)
    assert row[GLAND] == pytest.approx((1 - part) ** 3, abs=0.02)
    assert row[FAT] == pytest.approx(1 - (1 - part) ** 3, abs=0.02)


def test_octants_of_a_cube_are_distinguished():
    """Six tetrahedra of a cube of 8 mm around the diagonal, a tissue in one octant only.

    The octant at the far corner (x, y, z > half) is a cube on the diagonal that all six
    share, so it contains one eighth of each; the octant x > half, y, z < half
    cuts 1/8 of the volume of the cube from the two tetrahedra that go along x first.
    """
    side, low = 8.0, np.array([10.0, -20.0, 4.0])
    corners = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
    orders = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (1, 0, 2), (2, 1, 0)]
    tets = [[0, 1 << a, (1 << a) + (1 << b), 7] for a, b, _ in orders]
    mesh = TetMesh(low + side * corners, np.array(tets, np.int32))
    values = np.full((8, 8, 8), FAT, np.uint8)
    values[4:, 4:, 4:] = GLAND
    values[:4, :4, 4:] = LIGAMENT  # beyond the middle along x only
    volume = Volume(values, (1.0, 1.0, 1.0), tuple(low + 0.5))
    fractions = volume_fractions(mesh, volume)
    np.testing.assert_allclose(fractions[:, GLAND], 1 / 8, atol=0.02)
    first_along_x = np.array([a == 0 for a, _, _ in orders])
    # One eighth of the cube is 3/8 of the two tetrahedra with x first.
    np.testing.assert_allclose(fractions[first_along_x, LIGAMENT], 3 / 8, atol=0.02)
    assert np.all(fractions[~first_along_x, LIGAMENT] == 0)


@pytest.mark.parametrize("values", [np.full((9, 9, 9), 77, np.uint16), np.ones((9, 9, 9))])
def test_refuses_labels_that_are_not_tissues(values):
    mesh = TetMesh(np.eye(4, 3), np.array([[0, 1, 2, 3]], np.int32))
    with pytest.raises(InputError, match="Relabel"):
        majority_fractions(mesh, Volume(values, (1, 1, 1)))

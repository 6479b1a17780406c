"""Votes and volume fractions on volumes small enough to count."""

import numpy as np
import pytest

from storage.errors import InputError
from storage.values import TetMesh, Tissue, Volume
from workers.mesh.hierarchy import build_hierarchy
from workers.mesh.quality import volumes_mm3
from workers.mesh.tissues import majority_fractions, volume_fractions

AIR, FAT, GLAND, LIGAMENT = Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR, Tissue.LIGAMENT


def voted(at_nodes, at_centroid, elsewhere=AIR):
    """Tissue of a tetrahedron over 9^3 voxels of 1 mm whose five points read these labels."""
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
def test_five_points_vote(at_nodes, at_centroid, tissue):
    assert voted(at_nodes, at_centroid) == tissue


def test_all_in_air_takes_the_nearest_tissue():
    assert voted((AIR,) * 4, AIR, elsewhere=GLAND) == GLAND
    assert voted((AIR,) * 4, AIR) == FAT


def test_fractions_of_two_layers(breast):
    # Half ellipsoid cut at z = h: below lies pi a b (h - h^3 / (3 c^2)).
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


def test_a_cut_tetrahedron_is_sampled_in_proportion():
    # The corner of a cube of 20 mm, cut at z = 8: above remains (1 - 8/20)^3 of it.
    nodes = np.array([(0, 0, 0), (20, 0, 0), (0, 20, 0), (0, 0, 20)], float)
    mesh = TetMesh(nodes, np.array([[0, 1, 2, 3]], np.int32))
    labels = np.full((20, 20, 20), FAT, np.uint8)
    labels[8:] = LIGAMENT
    row = volume_fractions(mesh, Volume(labels, (1, 1, 1), (0.5, 0.5, 0.5)))[0]
    assert row[LIGAMENT] == pytest.approx(0.6**3, abs=0.02)
    assert row[FAT] + row[LIGAMENT] == pytest.approx(1)


@pytest.mark.parametrize("values", [np.full((9, 9, 9), 77, np.uint16), np.ones((9, 9, 9))])
def test_labels_that_are_no_tissues_are_refused(values):
    mesh = TetMesh(np.eye(4, 3), np.array([[0, 1, 2, 3]], np.int32))
    with pytest.raises(InputError, match="Relabel"):
        majority_fractions(mesh, Volume(values, (1, 1, 1)))

"""Bodies with a known overlap: moved and stretched cuboids, and noisy balls."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh, Volume
from palpate.workers.comparison.observation.interface_residual import GLANDULAR, OUTLINE, observe
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.body_pictures import (
    distances,
    on_one_box,
    overlaps,
    predict,
    reachable_jc,
)
from tests.workers.comparison.observation.redrawn import perturbed

# A fat cuboid from 0 to 24 x 16 x 12 mm with a glandular cuboid inside, in voxels of 1 mm.
SIZE = np.array([24, 16, 12])
CORE = np.array([[6, 18], [4, 12], [3, 9]])


def cuboid(stretch=(1, 1, 1), shift=(0, 0, 0)):
    """Return labels of the cuboid, with every axis stretched from 0 and then shifted."""
    x0, y0, z0 = shift
    nx, ny, nz = SIZE * stretch
    values = np.ones((nz, ny, nx), np.uint8)
    (ax, bx), (ay, by), (az, bz) = CORE * np.array(stretch)[:, None]
    values[az:bz, ay:by, ax:bx] = 2
    return Volume(values, (1.0, 1.0, 1.0), (x0 + 0.5, y0 + 0.5, z0 + 0.5))


def box_mesh():
    """Return a mesh of six tetrahedra around one diagonal of the cuboid."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * SIZE
    tets = np.array(
        [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]],
        np.int32,
    )
    return TetMesh(corners.astype(float), tets)


def test_a_correct_prediction_overlaps_fully():
    mesh, observed = box_mesh(), cuboid(stretch=(2, 1, 3))
    displacement = mesh.nodes * np.array([1.0, 0.0, 2.0])
    found = overlaps(predict(cuboid(), mesh, displacement, observed), observed)
    assert list(found) == ["outline", "glandular"]
    for score in found.values():
        assert (score.jc, score.dice, score.mhd_mm, score.gsf) == (1.0, 1.0, 0.0, -np.inf)


def test_overlap_of_a_shifted_body_is_its_share_of_the_length():
    mesh, observed = box_mesh(), cuboid(shift=(3, 0, 0))
    found = overlaps(predict(cuboid(), mesh, np.zeros_like(mesh.nodes), observed), observed)
    for name, length in (("outline", 24), ("glandular", 12)):
        assert found[name].jc == pytest.approx((length - 3) / (length + 3), rel=1e-12)
        assert found[name].dice == pytest.approx((length - 3) / length, rel=1e-12)
        assert 0 < found[name].mhd_mm < 3
        # The voxels are cubes of 1 mm, so both distances are numerically equal.
        assert found[name].gsf == pytest.approx(np.log((1 - found[name].jc) * found[name].mhd_mm))


@pytest.mark.parametrize("slices", [0, 2])
def test_nothing_is_predicted_below_the_slices_of_a_scan(slices):
    """The lower end of a body sinks by 2 mm, where the scan has two more slices or none."""
    mesh, whole = box_mesh(), cuboid()
    sunk = mesh.nodes * np.array([0.0, 0.0, 2 / 12]) - np.array([0.0, 0.0, 2.0])
    values = np.concatenate([whole.values[:1]] * slices + [whole.values])
    scan = Volume(values, whole.spacing_mm, (0.5, 0.5, 0.5 - slices))
    found = predict(whole, mesh, sunk, scan)
    assert found.origin_mm[2] == scan.origin_mm[2]
    assert overlaps(found, scan)["outline"].jc == 1.0


def test_reachable_jc_matches_noisy_balls():
    """Two segmentations of one ball differ by the amount expected from its area and the noise."""
    z, y, x = np.mgrid[-36:37, -36:37, -36:37]
    r = np.sqrt(x**2 + y**2 + z**2)
    # The noise on the gland is independent of the noise on the outline.
    ball = Volume((r < 30).astype(np.uint8) + (r < 18), (1.0, 1.0, 1.0), (-36.0, -36.0, -36.0))
    noise = SegmentationNoise(0.5, 6.0, 0.5, 0.08)
    first, second = (perturbed(ball, noise, seed) for seed in (1, 2))
    found = overlaps(first, second)
    # A voxel grid rounds each drawing by another 1 / sqrt(12) of an edge, averaged over directions;
    # two drawings share most of this error, so it is ignored.
    seen = observe(second, (OUTLINE, GLANDULAR)).distances
    outline, gland = (one.interface_mm2 for one in seen)
    for interface, area in ((OUTLINE, outline), (GLANDULAR, gland)):
        expected = reachable_jc(second, interface, area, np.full(9, 0.5 * np.sqrt(2.0)))
        assert 1 - found[interface.name].jc == pytest.approx(1 - expected, rel=0.15)
    assert reachable_jc(second, OUTLINE, outline, np.full(3, 1e-9)) == pytest.approx(1.0)
    assert reachable_jc(second, GLANDULAR, gland, np.full(3, 100.0)) == 0.0


def test_percentiles_use_one_interface():
    residual = np.array([-0.4, 9.0, 0.1, 0.2, -0.3, 9.0])
    interface = np.array([0, 1, 0, 0, 0, 1], np.int32)
    found = distances(residual, interface, 0)
    # Sorted absolute values: 0.1 0.2 0.3 0.4; the 95th percentile is 0.85 of the way from 0.3 to
    # 0.4.
    assert found.p50_mm == pytest.approx(0.25)
    assert found.p95_mm == pytest.approx(0.385)
    assert found.signed_mean_mm == pytest.approx(-0.1)
    assert found.points == 4


def test_bodies_in_one_box_keep_their_positions():
    """The bodies are rows of voxels along x, at 10 and at 12 mm::

    aa..
    ..bb   (one step along y)
    """
    first = Volume(np.full((1, 1, 2), 1, np.uint8), (1.0, 1.0, 2.0), (10.0, 5.0, 7.0))
    second = Volume(np.full((1, 1, 2), 2, np.uint8), (1.0, 1.0, 2.0), (12.0, 4.0, 7.0))
    box, origin = on_one_box([first, second])
    assert origin == (10.0, 4.0, 7.0)
    np.testing.assert_array_equal(box[0, 0], [[0, 0, 0, 0], [1, 1, 0, 0]])
    np.testing.assert_array_equal(box[1, 0], [[0, 0, 2, 2], [0, 0, 0, 0]])


def test_rejects_invalid_values():
    observed = cuboid()
    with pytest.raises(InputError, match="share a lattice"):
        on_one_box([observed, cuboid(shift=(0.3, 0, 0))])
    with pytest.raises(InputError, match="at least one point"):
        reachable_jc(observed, GLANDULAR, 1.0, np.empty(0))
    with pytest.raises(InputError, match="none of the 2 points"):
        distances(np.zeros(2), np.zeros(2, np.int32), 1)

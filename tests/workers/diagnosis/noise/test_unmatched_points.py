"""Points missing in one scan are found, and smooth motion of a body is not mistaken for them."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.diagnosis.noise.noise_components import smooth_columns
from palpate.workers.diagnosis.noise.unmatched_points import matched
from tests.workers.diagnosis.linear_world import ellipsoid, layout, mode, noise_covariance

K = 400
STATED = noise_covariance(K)
POINTS = InterfacePoints(
    *ellipsoid(K), np.zeros(K, np.int32), np.ones(K), part=np.zeros(K, np.int32)
)
BESIDE_MM = 8.0
PIECE = [40, 41, 222]  # points on tissue that the second scan does not show


NOTHING = np.zeros((2 * K, 0))


def smooth():
    return smooth_columns(*layout(K), np.full(2 * K, 0.8), 20.0, 0.8, 0.1)


def scanned(seed, noise=1.0, gap_mm=0.0):
    """Return noisy residuals of a body that bends differently from its model under load."""
    rng = np.random.default_rng(seed)
    drawn = rng.multivariate_normal(np.zeros(2 * K), noise_covariance(K), method="cholesky")
    return noise * drawn + gap_mm * mode(K, (2, 1, 0), 1, 1.5)


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0], ids="{} times the given noise".format)
def test_only_missing_pieces_are_unmatched(noise):
    for seed in range(3):
        residual = scanned(seed, noise)
        assert matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM).all()
        residual[[K + p for p in PIECE]] += [8.0, -6.0, 12.0]
        shown = matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM)
        np.testing.assert_array_equal(np.flatnonzero(~shown), PIECE)


def test_a_gap_of_millimetres_is_not_unmatched():
    for gap_mm in (0.5, 2.0, 4.0):
        residual = scanned(5, gap_mm=gap_mm)
        assert np.abs(residual).max() > 2.4 * gap_mm
        assert matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM).all()
        residual[PIECE[0]] += 8.0
        shown = matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM)
        np.testing.assert_array_equal(np.flatnonzero(~shown), PIECE[:1])


def test_points_near_missing_pieces_are_unmatched():
    points, _ = ellipsoid(K)
    away = np.linalg.norm(points - points[PIECE[0]], axis=1)
    beside = np.flatnonzero((away > 0) & (away < BESIDE_MM))
    assert len(beside)
    residual = scanned(1)
    residual[PIECE[0]] += 9.0
    residual[beside] = 1.6  # half as far off, as at the rim of a piece
    shown = matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM)
    assert set(np.flatnonzero(~shown)) == {PIECE[0], *beside.tolist()}


def test_neighbours_off_together_in_all_scans_are_unmatched():
    """The scan at rest seems to have a spurious piece of tissue: each point is five to six
    deviations from its surroundings, plausible for one point in one scan, but not for all
    together."""
    points, _ = ellipsoid(K)
    away = np.linalg.norm(points - points[PIECE[0]], axis=1)
    two = np.argsort(away)[:2]
    assert away[two[1]] < BESIDE_MM
    deviation_mm = np.sqrt(STATED[0, 0])
    for seed in (0, 3, 4):  # with other noise, a single point is off by more than six
        residual = scanned(seed)
        for scan in (0, 1):
            residual[scan * K + two] = -4.0 * deviation_mm
        shown = matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM)
        np.testing.assert_array_equal(np.flatnonzero(~shown), np.sort(two))
        residual[K + two] = deviation_mm
        residual[two] = -3.0 * deviation_mm
        assert matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM).all()


def test_many_outliers_are_not_called_unmatched():
    residual = scanned(2)
    many = np.random.default_rng(1).choice(K, K // 8, replace=False)
    residual[many] += 8.0
    assert matched(POINTS, STATED, NOTHING, smooth(), residual, BESIDE_MM).all()


def test_a_wholly_missing_piece_is_unmatched():
    """The piece is isolated, so a smooth displacement could explain all of it."""
    around, _ = ellipsoid(K)
    piece = np.argsort(np.linalg.norm(around - around[222], axis=1))[:4]
    part = np.zeros(K, np.int32)
    part[piece] = 1
    points = replace(POINTS, part=part)
    for seed, gap_mm in ((1, 0.0), (2, 2.0)):
        residual = scanned(seed, gap_mm=gap_mm)
        assert matched(points, STATED, NOTHING, smooth(), residual, BESIDE_MM).all()
        residual[K + piece] += 15.0
        shown = matched(points, STATED, NOTHING, smooth(), residual, BESIDE_MM)
        np.testing.assert_array_equal(np.flatnonzero(~shown), np.sort(piece))


def test_isolated_outliers_are_unmatched():
    """Two neighbours have no other points within 16 mm, so a free displacement follows them."""
    points, _ = ellipsoid(K)
    away = np.linalg.norm(points - points[PIECE[0]], axis=1)
    two = np.argsort(away)[:2]
    kept = np.flatnonzero((away > 16.0) | np.isin(np.arange(K), two))
    rows = np.concatenate([kept, K + kept])
    some, field = POINTS.of(kept), smooth()[rows]
    stated, nothing = STATED[np.ix_(rows, rows)], NOTHING[rows]
    lone = np.flatnonzero(np.isin(kept, two))
    for seed in range(3):
        residual = scanned(seed)[rows]
        assert matched(some, stated, nothing, field, residual, BESIDE_MM).all()
        both = np.concatenate([lone, len(kept) + lone])
        residual[both] -= 4.5
        shown = matched(some, stated, nothing, field, residual, BESIDE_MM)
        np.testing.assert_array_equal(np.flatnonzero(~shown), lone)
    bent = scanned(3, gap_mm=3.0)[rows]
    assert matched(some, stated, nothing, field, bent, BESIDE_MM).all()

"""A map of causes in a linear, normal world, in which the noise is known."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.diagnosis.fits.effect_screening import screen
from palpate.workers.diagnosis.linearisation import EffectSensitivity, Linearised, factored
from palpate.workers.diagnosis.outcome.residual_maps import CauseMap, cause_map, voxels

M, P = 80, 3
LINE = np.linspace(0.0, 60.0, M)
# A lump acts on the residuals within a few millimetres of it.
PLACES = np.array([[x, 0.0, 0.0] for x in (6.0, 18.0, 30.0, 42.0, 54.0)])


def world(residual):
    """Return a problem on a line with correlated noise and three free parameters."""
    covariance = 0.09 * np.exp(-0.5 * (np.subtract.outer(LINE, LINE) / 4.0) ** 2)
    factor = factored(covariance + 0.01 * np.eye(M))
    nominal = np.stack([np.ones(M), LINE / 30 - 1, (LINE / 30 - 1) ** 2], axis=1)
    return Linearised(residual, nominal, np.array([0.5, 0.3, 0.4]), np.zeros(P), factor)


def lump(strength=1.0):
    columns = strength * np.exp(-0.5 * ((LINE - PLACES[:, :1]) / 5.0) ** 2)
    return EffectSensitivity(
        "lump", "local", columns[:, :, None], np.array([1.5]), np.zeros(1, bool)
    )


def draws(count):
    """Return residuals with parameters and noise drawn from their priors."""
    rng = np.random.default_rng(5)
    empty = world(np.zeros(M))
    parameters = rng.standard_normal((P, count)) * empty.nominal_sd[:, None]
    return (
        empty.nominal @ parameters + empty.covariance_factor @ rng.standard_normal((M, count))
    ).T


def test_scores_of_noise_are_standard_normal_with_the_reported_maximum():
    found = [cause_map(world(residual), lump(), PLACES) for residual in draws(400)]
    z = np.array([one.z for one in found])
    assert abs(z.mean()) < 0.1
    # The standard error of a variance from 400 draws is 0.07.
    np.testing.assert_allclose(z.var(axis=0), 1.0, atol=0.25)
    level = found[0].reached_by_noise
    assert 2.0 < level < 3.0  # 1.96 for one place, 2.57 for five independent places
    assert 0.02 < (np.abs(z).max(axis=1) > level).mean() < 0.09


def test_locates_stiff_and_soft_spots_by_sign():
    for sign in (1, -1):
        residual = -sign * 2.4 * lump().columns[3, :, 0] + draws(1)[0]
        found = cause_map(world(residual), lump(), PLACES)
        assert found.loudest == 3
        assert sign * found.z[3] > found.reached_by_noise
        assert sign * found.estimate[3] == pytest.approx(2.4, abs=3 * found.sd[3])


def test_the_map_agrees_with_the_screening_of_the_best_place():
    residual = -1.2 * lump().columns[1, :, 0] + draws(1)[0]
    problem = world(residual)
    (result,) = screen(problem, [lump()])
    found = cause_map(problem, lump(), PLACES)
    at = result.place
    assert at == found.loudest
    assert found.estimate[at] == pytest.approx(result.estimate[0], rel=1e-9)
    assert found.sd[at] == pytest.approx(result.estimate_sd[0], rel=1e-9)
    # T = g^2 / (1 + i) and z^2 = g^2 / i, with the information i of the place.
    information = (1.5 / found.sd[at]) ** 2 - 1
    assert found.z[at] ** 2 * information / (1 + information) == pytest.approx(result.score)


def test_an_explained_spot_disappears_from_the_map():
    column = lump().columns[2]
    problem = world(-2.4 * column[:, 0] + draws(1)[0])
    before = cause_map(problem, lump(), PLACES)
    after = cause_map(problem.freed(column, np.array([30.0])), lump(), PLACES)
    assert abs(before.z[2]) > 4
    assert np.abs(after.z).max() < after.reached_by_noise
    assert before.seen[2]
    assert not after.seen[2]


def test_places_that_the_scans_cannot_show_are_marked_unseen():
    assert cause_map(world(np.zeros(M)), lump(), PLACES).seen.all()
    faint = cause_map(world(np.zeros(M)), lump(1e-3), PLACES)
    assert not faint.seen.any()
    np.testing.assert_allclose(faint.sd, 1.5, rtol=1e-3)


def scored(places, z, seen):
    g = len(z)
    return CauseMap(np.array(places), np.array(z), np.zeros(g), np.ones(g), np.array(seen), 3.0)


def test_voxels_are_exact_at_places_and_empty_elsewhere():
    """Places are at 1 and 9 mm in a body from 0 to 20 mm, with voxels of 2 mm."""
    body = Volume(np.ones((2, 2, 20), np.uint8), (1.0, 1.0, 1.0), (0.5, 0.5, 0.5))
    places = [[1.0, 1.0, 1.0], [9.0, 1.0, 1.0], [17.0, 1.0, 1.0]]
    drawn = voxels(scored(places, [4.0, -2.0, 5.0], [True, True, False]), body, 2.0)
    assert drawn.origin_mm == (1.0, 1.0, 1.0)
    assert drawn.values.shape == (1, 1, 10)
    line = drawn.values[0, 0]
    assert line[0] == pytest.approx(4.0, abs=1e-5)
    assert line[4] == pytest.approx(-2.0, abs=1e-5)
    assert (np.diff(line[:5]) < 0).all()
    # The map is empty from halfway to the unseen place onwards.
    assert np.isfinite(line[:6]).all()
    assert np.isnan(line[7:]).all()


def test_voxels_outside_the_body_or_far_from_places_are_empty():
    values = np.zeros((3, 3, 60), np.uint8)
    values[:, :, 10:] = 1
    body = Volume(values, (1.0, 1.0, 1.0))
    drawn = voxels(scored([[15.0, 1.0, 1.0]], [2.5], [True]), body, 1.0).values[1, 1]
    assert np.isnan(drawn[:10]).all()
    np.testing.assert_allclose(drawn[10:28], 2.5, rtol=1e-5)
    assert np.isnan(drawn[28:]).all()


def test_rejects_invalid_values():
    two = EffectSensitivity("two", "local", np.ones((5, M, 2)), np.ones(2), np.zeros(2, bool))
    with pytest.raises(InputError, match="one parameter"):
        cause_map(world(np.zeros(M)), two, PLACES)
    with pytest.raises(InputError, match="5 places"):
        cause_map(world(np.zeros(M)), lump(), PLACES[:4])
    body = Volume(np.ones((2, 2, 2), np.uint8), (1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="voxel size of a map must be > 0"):
        voxels(scored([[1.0, 1.0, 1.0]], [1.0], [True]), body, 0.0)

"""Held constants are uncertain in every hypothesis, by the amount given in their effect."""

import numpy as np
import pytest

from palpate.workers.diagnosis.fits.gauss_newton import fit
from palpate.workers.diagnosis.fits.model_errors import held_columns
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.workers.diagnosis.fits.test_gauss_newton import FREE, analysed, problem_between_plates

effect = CATALOGUE.named
COMPRESSIBILITY = effect("compressibility")


@pytest.fixture(scope="module")
def analysis():
    inverse = problem_between_plates()
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None, None])
    return analysed(inverse, nominal, [COMPRESSIBILITY, effect("plate_tilt")])


def test_held_columns_are_the_effect_times_its_held_sd(analysis):
    m = len(analysis.inverse.bias)
    found = held_columns(analysis.sensitivities, m)
    assert found.shape == (m, 1)
    of_nu = analysis.sensitivity_by_name["compressibility"].places[0][:, 0]
    np.testing.assert_allclose(found[:, 0], of_nu * COMPRESSIBILITY.held_sd[0])
    # 1 - 2 nu for a given nu of 0.49, off by up to 0.002 in either direction, uniformly.
    off = np.log((1 - 2 * (0.49 + np.linspace(-0.002, 0.002, 2001))) / 0.02)
    assert off.std() == pytest.approx(COMPRESSIBILITY.held_sd[0], rel=0.02)


def test_every_hypothesis_includes_held_constants(analysis):
    own = analysis.nominal.hypothesis(analysis.inverse)
    found = analysis.hypothesis(analysis.nominal)
    held = held_columns(analysis.sensitivities, len(analysis.inverse.bias))
    np.testing.assert_array_equal(found.columns, np.hstack([own.columns, held]))
    assert not found.is_pose[-1]
    assert not found.one_sided[-1]


def test_effects_without_held_sd_are_ignored():
    assert held_columns([], 12).shape == (12, 0)

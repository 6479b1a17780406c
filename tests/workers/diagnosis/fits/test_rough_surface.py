"""A rough mesh is not mistaken for a skin."""

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.model_errors import RoughSurface
from palpate.workers.diagnosis.noise.averaged_evidence import LinearHypothesis
from tests.workers.diagnosis.linear_world import effect, known_noise_model, mode, nominal_problem

K = 60
NOISE = SETTINGS.noise


def skin():
    """Return the residuals in mm for 1 N/mm, equally steep at small and large magnitudes."""
    return effect("skin_added", -12.0 * mode(K, (2, 0, 0), 0, 1.0), sd=1.0, one_sided=True)


def hypothesis(residual, *more):
    p = nominal_problem(K)
    columns = np.column_stack([p.nominal * p.nominal_sd, *more])
    n = columns.shape[1]
    none = np.zeros(n, bool)
    sided = none.copy()
    sided[p.nominal.shape[1] :] = True
    return LinearHypothesis(residual, columns, np.zeros(n), sided, none)


def gain(n_per_mm, drawn_sd_mm):
    """Return the log evidence for a skin, given the residuals of a skin of this size."""
    column = skin().places[0][:, 0]
    rough = RoughSurface.like(skin(), drawn_sd_mm)
    noise, residual = known_noise_model(K), -n_per_mm * column
    without, beside = (rough.taken_off(hypothesis(residual, *c)) for c in ((), (column,)))
    return noise.log_evidence(beside) - noise.log_evidence(without)


def test_separates_a_rough_mesh_from_a_skin() -> None:
    like_skin = NOISE.rough_skin_n_per_mm
    assert gain(like_skin, NOISE.rough_at_mm) < 0
    assert gain(3 * like_skin, NOISE.rough_at_mm) < 3.0
    assert gain(10 * like_skin, NOISE.rough_at_mm) > 20.0
    # On scans drawn twice as accurately, the same residuals do indicate a skin.
    assert gain(3 * like_skin, 0.5 * NOISE.rough_at_mm) > 3.0


def test_bias_grows_with_the_square_of_the_roughness() -> None:
    column = skin().places[0][:, 0]
    once, twice = (RoughSurface.like(skin(), f * NOISE.rough_at_mm) for f in (1.0, 2.0))
    np.testing.assert_allclose(once.expected, -NOISE.rough_skin_n_per_mm * column)
    np.testing.assert_allclose(twice.expected, 4 * once.expected)
    np.testing.assert_allclose(twice.column, 4 * once.column)
    found = once.taken_off(hypothesis(once.expected))
    assert np.abs(found.residual).max() == pytest.approx(0.0, abs=1e-12)
    assert found.columns.shape[1] == nominal_problem(K).nominal.shape[1] + 1

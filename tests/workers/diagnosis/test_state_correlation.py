"""Correlation of two states, given the directions of their loads."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS, StateCorrelation
from palpate.workers.diagnosis.noise.noise_components import smooth_columns
from tests.workers.diagnosis.linear_world import ellipsoid

X, Y = np.eye(3)[:2]
OBLIQUE = (X + Y) / np.sqrt(2)


def test_correlation_is_larger_along_one_direction():
    found = StateCorrelation(along=0.8, across=0.2).between(np.array([X, -X, Y, OBLIQUE]))
    expected = [[1, 0.8, 0.2, 0.5], [0.8, 1, 0.2, 0.5], [0.2, 0.2, 1, 0.5], [0.5, 0.5, 0.5, 1]]
    assert found == pytest.approx(np.array(expected))


def test_correlations_of_any_directions_are_positive_semi_definite():
    rng = np.random.default_rng(1)
    for along, across in ((1.0, 0.0), (0.94, 0.0), (0.8, 0.3), (0.5, 0.5)):
        drawn = rng.standard_normal((12, 3))
        directions = drawn / np.linalg.norm(drawn, axis=1)[:, None]
        found = StateCorrelation(along, across).between(directions)
        assert np.linalg.eigvalsh(found).min() > -1e-12


@pytest.mark.parametrize(("along", "across"), [(0.5, 0.6), (1.1, 0.0), (0.5, -0.1)])
def test_rejects_invalid_correlations(along, across):
    with pytest.raises(InputError, match="0 <= across <= along <= 1"):
        StateCorrelation(along, across)


def test_columns_of_several_scans_have_the_state_correlation():
    """Numerical errors under loads in perpendicular directions are only weakly correlated."""
    points, normals = ellipsoid(60)
    between = SETTINGS.numerical.state_correlation.between(np.array([X, X, Y]))
    states = np.repeat(np.arange(3), 60)
    at = np.tile(points, (3, 1)), np.tile(normals, (3, 1)), states
    columns = smooth_columns(*at, np.full(180, 0.05), 20.0, between, 1e-8)
    blocks = (columns @ columns.T).reshape(3, 60, 3, 60)
    own = blocks[0, :, 0]
    assert blocks[0, :, 1] == pytest.approx(between[0, 1] * own, abs=1e-6)
    assert blocks[0, :, 2] == pytest.approx(between[0, 2] * own, abs=1e-6)
    assert between[0, 2] < 0.2 < between[0, 1]

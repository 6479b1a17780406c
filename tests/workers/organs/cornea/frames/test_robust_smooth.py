"""Robust smoothing: parabolas, waves and outliers."""

import numpy as np
import pytest

from palpate.workers.organs.cornea.frame_segmentation import robust_smooth

X = np.arange(400.0)


def test_preserves_a_parabola_across_gaps_and_outliers() -> None:
    parabola = 30 + 0.1 * X - 2e-4 * X**2
    values, weights = parabola.copy(), np.ones(400)
    values[::17] += 40.0
    values[200:240] = np.nan
    weights[200:240] = 0.0
    assert np.allclose(robust_smooth(values, weights, 40.0), parabola, atol=1e-3)


@pytest.mark.parametrize(("times", "kept"), [(1.0, 0.5), (2.0, 64 / 65), (0.5, 1 / 65)])
def test_short_waves_are_damped_and_long_ones_kept(times: float, kept: float) -> None:
    wave = np.sin(2 * np.pi * X / (40.0 * times))
    # Without reweighting, which is not linear; away from the ends.
    smooth = robust_smooth(wave, np.ones(400), 40.0, rounds=1)
    middle = slice(120, 280)
    amplitude = 2 * np.mean(smooth[middle] * wave[middle])
    assert amplitude == pytest.approx(kept, abs=0.02)

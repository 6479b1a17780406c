"""Contours of corner plots contain the stated shares of the draws."""

import numpy as np
import pytest

from palpate.service.report.drawing.matplotlib_figures import (
    BINS,
    SHARES,
    CornerVariable,
    _levels,
    corner_plot,
    svg,
)


def variables() -> list[CornerVariable]:
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((2, 20_000))
    return [
        CornerVariable("a", 10 + a, (8.4, 11.6), 10.0, 10.5),
        CornerVariable("b, kPa", 5 + 0.8 * a + 0.6 * b, (3.4, 6.6), 5.0),
    ]


def test_pairs_are_below_the_diagonal() -> None:
    drawn = corner_plot(variables())
    shown = [axes for axes in drawn.axes if axes.axison]
    assert (len(drawn.axes), len(shown)) == (4, 3)
    assert [axes.get_xlabel() for axes in shown] == ["", "a", "b, kPa"]
    low, high = shown[0].get_xlim()
    assert low < 8.4 < 11.6 < high
    assert svg(drawn) == svg(corner_plot(variables()))


def test_contours_hold_their_shares_of_the_draws() -> None:
    a, b = variables()
    counts, *_ = np.histogram2d(a.draws, b.draws, BINS)
    held = [counts[counts >= level].sum() / counts.sum() for level in _levels(counts)]
    assert held == pytest.approx(SHARES, abs=0.02)

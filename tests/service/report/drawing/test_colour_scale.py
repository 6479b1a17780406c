"""Colours of signed numbers."""

import re

import numpy as np
import pytest

from palpate.service.report.drawing.colours import SIGNED, ColourScale, colour_bar
from palpate.service.report.drawing.svg import Svg

GREYS = ColourScale(("#000000", "#808080", "#ffffff"), 2.0)


def test_colours_are_linear_between_their_stops() -> None:
    shown = GREYS.at(np.array([-2.0, -1.0, 0.0, 2.0]))
    np.testing.assert_allclose(shown[:, 0], [0.0, 64 / 255, 128 / 255, 1.0])
    np.testing.assert_array_equal(shown[:, 0], shown[:, 2])
    assert GREYS.written(np.array([-2.0, 0.0])) == ["#000000", "#808080"]


def test_numbers_beyond_the_ends_have_the_colour_of_the_end() -> None:
    assert GREYS.written(np.array([-9.0, 9.0])) == ["#000000", "#ffffff"]


def test_positive_is_red_and_negative_is_blue() -> None:
    inside, outside = ColourScale(SIGNED, 1.0).at(np.array([-0.6, 0.6]))
    assert inside[2] > inside[0]
    assert outside[0] > outside[2]


@pytest.mark.parametrize("height", [60.0, 150.0, 500.0])
def test_colour_bar_ticks_are_at_their_values(height: float) -> None:
    svg = Svg(100, height)
    colour_bar(svg, GREYS, 10.0, (0.0, height), "label", strokes=(1.0,))
    ticks = {
        float(text.replace("\u2212", "-")): float(y) - 4
        for y, text in re.findall(
            r'<text x="32" y="([\d.]+)" class="tick">([^<]+)<', "".join(svg.parts)
        )
    }
    assert 2 <= len(ticks) <= 11
    for value, y in ticks.items():
        assert y == pytest.approx(height * (2 - value) / 4, abs=0.06)
    places = sorted(ticks.values())
    assert min(np.diff(places)) >= 15
    (stroke,) = (part for part in svg.parts if "whisker" in part)
    assert f"M10.0 {height / 4:.1f}" in stroke

"""Formatting of numbers and names."""

import math

import pytest

from palpate.service import number_formatting


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.0, "0"),
        (-0.00012, "−1.20·10⁻⁴"),
        (99_996.0, "99996"),
        (-math.inf, "−∞"),
        (math.nan, "–"),
        (0.1, "0.1"),
    ],
)
def test_numbers_are_rounded_for_readers(value: float, said: str) -> None:
    assert number_formatting.number(value) == said


def test_relative_error_is_signed() -> None:
    assert number_formatting.signed_error(9.0, 10.0) == pytest.approx(-0.1)
    assert number_formatting.signed_error(11.0, 10.0) == pytest.approx(0.1)
    assert number_formatting.signed_error(1.0, 0.0) is None
    assert number_formatting.signed_error(None, 1.0) is None


def test_edge_is_one_percent_of_interval() -> None:
    assert number_formatting.at_edge(5.1, (5.0, 20.0))
    assert not number_formatting.at_edge(5.2, (5.0, 20.0))
    assert number_formatting.at_edge(19.9, (5.0, 20.0))

"""Words and numbers, and figures that are the same every time."""

import doctest
import math

import pytest
from matplotlib import rcParams

from service import formatting
from service.report import study_figures
from service.report.canvas import svg
from service.report.study_figures import EvaluationPoint, SearchedParameter
from service.report.study_pictures import best_tenth


def test_the_examples_in_the_docstrings() -> None:
    told = doctest.testmod(formatting)
    assert told.failed == 0
    assert told.attempted >= 8


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.0, "0"),
        (-0.00012, "−1.20·10^−4"),
        (99_996.0, "99996"),
        (-math.inf, "−∞"),
        (math.nan, "–"),
        (0.1, "0.1"),
    ],
)
def test_numbers(value: float, said: str) -> None:
    assert formatting.number(value) == said


def test_the_sign_of_an_error_says_on_which_side() -> None:
    assert formatting.signed_error(9.0, 10.0) == pytest.approx(-0.1)
    assert formatting.signed_error(11.0, 10.0) == pytest.approx(0.1)
    assert formatting.signed_error(1.0, 0.0) is None
    assert formatting.signed_error(None, 1.0) is None


def test_an_edge_is_a_hundredth_of_the_interval() -> None:
    assert formatting.at_edge(5.1, (5.0, 20.0))
    assert not formatting.at_edge(5.2, (5.0, 20.0))
    assert formatting.at_edge(19.9, (5.0, 20.0))


def points() -> list[EvaluationPoint]:
    scores = [-1.0, math.inf, -math.inf, 0.5, -2.0]
    return [EvaluationPoint(i // 3, {"E": float(i)}, score) for i, score in enumerate(scores)]


def test_infinite_scores_leave_the_axis_finite() -> None:
    drawn = study_figures.convergence(points(), [-math.inf, -2.0], [math.nan, -0.75])
    (axes,) = drawn.axes
    low, high = axes.get_ylim()
    assert -3.0 < low < -2.0 < 0.5 < high < 1.0
    assert "identical to the target (−∞)" in svg(drawn)


def test_a_search_with_nothing_but_failures_can_be_drawn() -> None:
    failed = [EvaluationPoint(0, {"E": 1.0}, math.inf)] * 3
    text = svg(study_figures.convergence(failed, [math.inf], [math.nan]))
    assert "failed" in text
    drawn = study_figures.convergence(points(), [math.inf, -2.0], [math.nan, -0.75])
    (line,) = [l for l in drawn.axes[0].lines if l.get_label() == "best so far"]
    assert [math.isnan(y) for y in line.get_ydata()] == [True, False]


def test_a_figure_has_the_same_bytes_twice_and_leaves_the_settings_alone() -> None:
    found = SearchedParameter("E", "E, kPa", 0.0, 5.0, 2.0, 2.5)
    before = dict(rcParams)
    first, second = (svg(study_figures.scatter(found, points(), 2)) for _ in range(2))
    assert first == second
    assert dict(rcParams) == before
    assert "DejaVu" not in first


def test_marks_stand_where_their_values_are() -> None:
    found = SearchedParameter("E", "E, kPa", 10.0, 20.0, 12.5, 17.5)
    (axes,) = study_figures.ranges([found], {"E": [15.0]}).axes
    places = {line.get_marker(): line.get_xdata() for line in axes.lines}
    assert places["o"] == [0.25]
    assert places["D"] == [0.75]
    assert places["|"] == [0.5]


def test_the_best_tenth_counts_candidates_once() -> None:
    told = [EvaluationPoint(0, {"E": float(i)}, float(i)) for i in range(30)]
    assert best_tenth([*told, *told]) == {"E": [0.0, 1.0, 2.0]}
    assert best_tenth([EvaluationPoint(0, {"E": 1.0}, math.inf)]) == {}

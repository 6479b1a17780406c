"""Charts of a search: marks are at their values."""

import math
import re
from xml.etree import ElementTree

import pytest

from palpate.service.report.drawing.svg import Scale, Svg, scale_between, tick_text
from palpate.service.report.study import study_charts
from palpate.service.report.study.study_charts import EvaluationPoint, SearchedParameter
from palpate.service.report.study.study_pictures import best_tenth

FOUND = SearchedParameter("E", "E, kPa", 10.0, 20.0, 12.5, 17.5, (12.0, 14.0))


def points() -> list[EvaluationPoint]:
    scores = [-1.0, math.inf, -math.inf, 0.5, -2.0]
    return [EvaluationPoint(i // 3, {"E": 10.0 + i}, score) for i, score in enumerate(scores)]


def parsed(svg: Svg) -> ElementTree.Element:
    return ElementTree.fromstring(str(svg.markup("a chart")))


def classed(drawing: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    return [e for e in drawing.iter() if name in e.get("class", "").split()]


def places(path: ElementTree.Element) -> list[tuple[float, float]]:
    found = re.findall(r"M([-\d.]+) ([-\d.]+)h0", path.get("d", ""))
    return [(float(x), float(y)) for x, y in found]


def test_dots_have_evaluation_numbers() -> None:
    drawing = parsed(
        study_charts.convergence_chart(points(), [-math.inf, -2.0], [math.nan, -0.75], 900)
    )
    (dots,) = [e for e in classed(drawing, "dots") if e.get("data-i")]
    assert dots.get("data-i") == "0 3 4"  # neither the failure nor the identical one
    (first, second, third) = places(dots)
    assert first[0] < second[0] < third[0]
    # Lower is better, and lower on the page; equal steps of the score are equal steps in pixels.
    assert second[1] < first[1] < third[1]
    assert (third[1] - second[1]) / (first[1] - second[1]) == pytest.approx(2.5 / 1.5, rel=1e-2)


def test_infinite_scores_leave_the_axis_finite() -> None:
    drawing = parsed(
        study_charts.convergence_chart(points(), [-math.inf, -2.0], [math.nan, -0.75], 900)
    )
    assert "identical to the target (−∞)" in "".join(drawing.itertext())
    assert len(classed(drawing, "identical")) == 2  # in the legend and in the chart
    assert len(classed(drawing, "failed")) == 2
    assert "nan" not in ElementTree.tostring(drawing, "unicode")
    assert "inf" not in ElementTree.tostring(drawing, "unicode")


def test_a_search_with_nothing_but_failures_can_be_drawn() -> None:
    failed = [EvaluationPoint(0, {"E": 11.0}, math.inf)] * 3
    drawing = parsed(study_charts.convergence_chart(failed, [math.inf], [math.nan], 900))
    assert len(classed(drawing, "failed")) == 1 + 3
    assert not [e for e in classed(drawing, "best") if "M" in e.get("d", "")][1:]


@pytest.mark.parametrize("width", [900.0, 400.0])
def test_marks_are_at_their_values(width: float) -> None:
    drawing = parsed(study_charts.range_chart([FOUND], {"E": [15.0]}, width))
    (track,) = classed(drawing, "track")
    left, right = map(float, re.findall(r"M([\d.]+) [\d.]+H([\d.]+)", track.get("d", ""))[0])
    scale = Scale(10.0, 20.0, left, right)
    (dot,) = [e for e in classed(drawing, "estimate") if float(e.get("r", 0)) == 5.5]
    assert float(dot.get("cx", 0)) == pytest.approx(scale.at(12.5), abs=0.1)
    (box,) = [e for e in classed(drawing, "interval") if e.get("height") == "14"]
    start = float(box.get("x", 0))
    assert start == pytest.approx(scale.at(12.0), abs=0.1)
    assert start + float(box.get("width", 0)) == pytest.approx(scale.at(14.0), abs=0.2)
    strokes = [e.get("d", "") for e in classed(drawing, "cloud")]
    assert any(s.startswith(f"M{scale.at(15.0):.1f} ") for s in strokes)


@pytest.mark.parametrize("width", [900.0, 400.0])
def test_nothing_is_drawn_outside_chart(width: float) -> None:
    """Marks and text start inside; the width of text is estimated from its letters."""
    for svg in (
        study_charts.convergence_chart(points(), [-1.0, -2.0], [0.0, -0.75], width),
        study_charts.range_chart([FOUND], {"E": [15.0]}, width),
        study_charts.stage_chart({"solve": 9.0, "score": 1.0}, width),
    ):
        for text in parsed(svg).iter("text"):
            x, half = float(text.get("x", 0)), 3.2 * len(text.text or "")
            anchor = text.get("text-anchor", "start")
            left = x - {"start": 0.0, "middle": half, "end": 2 * half}[anchor]
            if text.get("transform"):
                continue
            assert left > -1
            assert left + 2 * half < width + 1


def test_scatter_is_reproducible_and_names_dots() -> None:
    first, second = (study_charts.scatter_chart(FOUND, points(), 2).markup("E") for _ in range(2))
    assert first == second
    drawing = ElementTree.fromstring(str(first))
    told = sorted(n for e in classed(drawing, "dots") for n in e.get("data-i", "").split())
    assert told == ["0", "3", "4"]


@pytest.mark.parametrize(
    ("lower", "upper", "most", "ticks"),
    [
        (0.0, 1.0, 5, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-3.2, 0.4, 6, ["−3", "−2", "−1", "0"]),
        (0.5, 5.5, 5, ["1", "2", "3", "4", "5"]),
        (1.0, 1.002, 4, ["1", "1.0005", "1.001", "1.0015", "1.002"]),
    ],
)
def test_ticks_are_round(lower: float, upper: float, most: int, ticks: list[str]) -> None:
    assert [tick_text(t) for t in Scale(lower, upper, 0.0, 100.0).ticks(most)] == ticks


def test_the_best_tenth_counts_candidates_once() -> None:
    told = [EvaluationPoint(0, {"E": float(i)}, float(i)) for i in range(30)]
    assert best_tenth([*told, *told]) == {"E": [0.0, 1.0, 2.0]}
    assert best_tenth([EvaluationPoint(0, {"E": 1.0}, math.inf)]) == {}


def test_values_over_decades_are_shown_by_their_logarithms() -> None:
    """0.1 to 1000: each decade is as wide as the next, and ticks are powers of ten."""
    scale = scale_between(0.1, 1000.0, 0.0, 400.0)
    assert [scale.at(v) for v in (0.1, 1.0, 10.0, 1000.0)] == pytest.approx([0, 100, 200, 400])
    assert scale.ticks(6) == pytest.approx([0.1, 1.0, 10.0, 100.0, 1000.0])
    assert scale.ticks(13) == pytest.approx(
        [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0]
    )
    assert len(scale_between(1e-9, 1e9, 0.0, 400.0).ticks(6)) <= 6
    for limits in ((1.0, 50.0), (-1.0, 1000.0), (0.0, 1000.0)):
        assert type(scale_between(*limits, 0.0, 400.0)) is Scale


def test_a_scatter_over_decades_has_both_axes_logarithmic() -> None:
    wide = SearchedParameter("E", "E, kPa", 1.0, 1000.0, 10.0, None)
    scores = [100.0, 1.0, 0.01]
    evaluated = [EvaluationPoint(0, {"E": 10.0**k}, s) for k, s in enumerate(scores)]
    drawing = parsed(study_charts.scatter_chart(wide, evaluated, 1))
    (dots,) = [e for e in classed(drawing, "dots") if e.get("data-i")]
    (x0, y0), (x1, y1), (x2, y2) = places(dots)
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.2)
    assert y1 - y0 == pytest.approx(y2 - y1, abs=0.2)

"""Charts of a comparison: the constants of all studies, and the convergence of their scores."""

import math
from collections.abc import Sequence

from palpate.service.formatting import label, number
from palpate.service.report.drawing.svg import (
    Mark,
    Scale,
    Svg,
    horizontal_axis,
    legend,
    text_width,
    tick_text,
    vertical_axis,
)
from palpate.service.results.comparison import ComparedStudy, StudyComparison
from palpate.service.results.record import ParameterEstimate

NARROW = 600.0
ROW_PX = 30.0
# Colours and dashes of lines in the style sheet.
LINES = 6
MOST_LETTERS = 34


def constants(comparison: StudyComparison, gene: str, width: float) -> Svg:
    """Draw the estimates of one constant with their intervals, one row for each study."""
    found = [(s.label, e) for s in comparison.studies if (e := comparison.estimate(s, gene))]
    known = [(name, e, e.estimate) for name, e in found if e.estimate is not None]
    unit = found[0][1].unit
    narrow = width < NARROW
    left = 8.0 if narrow else 24 + max(text_width(_short(name), 14) for name, _ in found)
    row_px = ROW_PX + (18 if narrow else 0)
    svg = Svg(width, 0)
    items: list[tuple[Mark, str, str]] = [("dot", "dot estimate", "estimate")]
    items.append(("box", "interval", "90 % interval"))
    if any(e.target is not None for _, e in found):
        items.append(("diamond", "target", "target"))
    y = 12 + legend(svg, items, left, 12, width)
    scale = _scale([e for _, e, _ in known], left + 8, width - 14)
    bottom = y + row_px * len(found)
    horizontal_axis(svg, scale, bottom, label(gene, unit), 4 if narrow else 8, y)
    for row, (name, e) in enumerate(found):
        middle = y + row_px * (row + 0.5) + (8 if narrow else 0)
        if narrow:
            svg.text(left, middle - 12, _short(name), class_="tick")
        else:
            svg.text(left - 12, middle + 4, _short(name), text_anchor="end", class_="name")
        _row(svg, scale, e, middle)
    svg.height = bottom + 42
    return svg


def convergence(comparison: StudyComparison, width: float) -> Svg:
    """Draw the lowest score of every study against the number of evaluations, on a log axis."""
    svg = Svg(width, 340.0)
    items: list[tuple[Mark, str, str]] = [
        ("line", _line(n), _short(study.label)) for n, study in enumerate(comparison.studies)
    ]
    top = 10 + legend(svg, items, 54, 12, width) + 6
    finite = [s for study in comparison.studies for s in study.lowest_scores if math.isfinite(s)]
    low, high = min(finite), max(finite)
    room = 0.06 * (high - low) or 0.06 * max(1.0, abs(high))
    up = Scale(low - room, high + room, 290, top)
    most = max(len(study.lowest_scores) for study in comparison.studies)
    across = Scale(0.0, math.log10(max(2, most)), 54, width - 14)
    vertical_axis(svg, up, 54, f"lowest {comparison.axis} so far", width - 14)
    _log_axis(svg, across, most, 290, width < NARROW)
    for n, study in enumerate(comparison.studies):
        svg.polyline(_steps(study, across, up), _line(n))
    return svg


def _row(svg: Svg, scale: Scale, e: ParameterEstimate, y: float) -> None:
    if e.interval is not None:
        ends = [scale.at(min(max(v, scale.lower), scale.upper)) for v in e.interval]
        box = {"x": ends[0], "y": y - 6, "width": max(2.0, ends[1] - ends[0]), "height": 12.0}
        svg.add("rect", class_="interval", rx=3, **box)
    if e.target is not None and scale.lower <= e.target <= scale.upper:
        svg.mark("diamond", scale.at(e.target), y, "target", 6)
    if e.estimate is None:
        svg.text(scale.start, y + 4, "not estimated", class_="tick")
        return
    svg.mark("dot", scale.at(e.estimate), y, "dot estimate", 5)


def _scale(estimates: Sequence[ParameterEstimate], start: float, end: float) -> Scale:
    """Return an axis around all estimates, intervals and targets, within the search bounds."""
    if not estimates:
        return Scale(0.0, 1.0, start, end)
    shown: list[float] = []
    for e in estimates:
        shown += [v for v in (e.estimate, e.target, *(e.interval or ())) if v is not None]
    low, high = min(shown), max(shown)
    low, high = (
        max(low, min(e.lower for e in estimates)),
        min(high, max(e.upper for e in estimates)),
    )
    room = 0.08 * (high - low) or 0.08 * max(abs(high), 1e-12)
    return Scale(low - room, high + room, start, end)


def _steps(study: ComparedStudy, across: Scale, up: Scale) -> list[tuple[float, float]]:
    """Return the corners of a descending step curve, without infinite scores."""
    places: list[tuple[float, float]] = []
    for index, score in enumerate(study.lowest_scores):
        if not math.isfinite(score):
            continue
        x, y = across.at(math.log10(index + 1)), up.at(score)
        if places and places[-1][1] != y:
            places.append((x, places[-1][1]))
        if not places or places[-1][1] != y or index == len(study.lowest_scores) - 1:
            places.append((x, y))
    if len(places) == 1:
        places.append((places[0][0] + 3, places[0][1]))
    return places


def _log_axis(svg: Svg, across: Scale, most: int, y: float, narrow: bool) -> None:
    """Draw ticks at 1, 2, 5, 10, 20 ... evaluations, or at powers of ten on a narrow page."""
    steps = (1,) if narrow and most > 100 else (1, 2, 5)
    for power in range(len(str(most))):
        for step in steps:
            value = step * 10**power
            if value > most:
                continue
            x = across.at(math.log10(value))
            svg.add("path", d=f"M{x:.1f} {y:.1f}v4", class_="axis")
            svg.text(x, y + 16, tick_text(float(value)), text_anchor="middle", class_="tick")
    svg.add("path", d=f"M{across.start:.1f} {y:.1f}H{across.end:.1f}", class_="axis")
    svg.text((across.start + across.end) / 2, y + 34, "evaluations", text_anchor="middle")


def _line(n: int) -> str:
    return f"line{n % LINES}" + (" again" if n >= LINES else "")


def _short(name: str) -> str:
    """Return the end of a long label, where the names of folders differ."""
    return name if len(name) <= MOST_LETTERS else f"…{name[-MOST_LETTERS + 1 :]}"


def constants_words(comparison: StudyComparison, gene: str) -> str:
    """Return the alternative text of a chart of constants."""
    texts = []
    for study in comparison.studies:
        e = comparison.estimate(study, gene)
        if e is None:
            continue
        between = "" if e.interval is None else f" ({' to '.join(map(number, e.interval))})"
        texts.append(f"{study.label}: {number(e.estimate)}{between} {e.unit}".rstrip())
    return f"{label(gene, found_unit(comparison, gene))}. {'; '.join(texts)}."


def found_unit(comparison: StudyComparison, gene: str) -> str:
    """Return the unit of a constant; empty for a pure number."""
    found = (comparison.estimate(study, gene) for study in comparison.studies)
    return next(e.unit for e in found if e is not None)

"""The page of a comparison of studies, in one self-contained file, with its charts.

The charts show the constants of all studies, and the convergence of their scores.
"""

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup

from palpate.service.installed_packages import palpate_version
from palpate.service.number_formatting import count, duration, label, listed, number, symbol
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
from palpate.service.report.page.page_elements import Picture, chart, filled
from palpate.service.results.quotability_rule import names_by_reason
from palpate.service.results.result_records import ParameterEstimate
from palpate.service.results.study_comparison import ComparedStudy, StudyComparison
from palpate.storage.backends.atomic_files import write_file

NARROW = 600.0
ROW_PX = 30.0
# Colours and dashes of lines in the style sheet.
LINE_CLASSES = 6
MOST_LETTERS = 34


def constant_chart(comparison: StudyComparison, gene: str, width: float) -> Svg:
    """Draw the estimates of one constant with their intervals, one row for each study."""
    estimates = [(s.label, e) for s in comparison.studies if (e := comparison.estimate(s, gene))]
    known = [(name, e, e.estimate) for name, e in estimates if e.estimate is not None]
    unit = estimates[0][1].unit
    narrow = width < NARROW
    left = 8.0 if narrow else 24 + max(text_width(_short_label(name), 14) for name, _ in estimates)
    row_px = ROW_PX + (18 if narrow else 0)
    svg = Svg(width, 0)
    items: list[tuple[Mark, str, str]] = [("dot", "dot estimate", "estimate")]
    items.append(("box", "interval", "90 % interval"))
    if any(e.target is not None for _, e in estimates):
        items.append(("diamond", "target", "target"))
    y = 12 + legend(svg, items, left, 12, width)
    scale = _estimate_scale([e for _, e, _ in known], left + 8, width - 14)
    bottom = y + row_px * len(estimates)
    horizontal_axis(svg, scale, bottom, label(gene, unit), 4 if narrow else 8, y)
    for row, (name, e) in enumerate(estimates):
        middle = y + row_px * (row + 0.5) + (8 if narrow else 0)
        if narrow:
            svg.text(left, middle - 12, _short_label(name), class_="tick")
        else:
            svg.text(left - 12, middle + 4, _short_label(name), text_anchor="end", class_="name")
        _estimate_row(svg, scale, e, middle)
    svg.height = bottom + 42
    return svg


def score_chart(comparison: StudyComparison, width: float) -> Svg:
    """Draw the lowest score of every study against the number of evaluations, on a log axis."""
    svg = Svg(width, 340.0)
    items: list[tuple[Mark, str, str]] = [
        ("line", _line_class(n), _short_label(study.label))
        for n, study in enumerate(comparison.studies)
    ]
    top = 10 + legend(svg, items, 54, 12, width) + 6
    finite = [s for study in comparison.studies for s in study.lowest_scores if math.isfinite(s)]
    low, high = min(finite), max(finite)
    room = 0.06 * (high - low) or 0.06 * max(1.0, abs(high))
    up = Scale(low - room, high + room, 290, top)
    most = max(len(study.lowest_scores) for study in comparison.studies)
    across = Scale(0.0, math.log10(max(2, most)), 54, width - 14)
    vertical_axis(svg, up, 54, f"lowest {comparison.axis} so far", width - 14)
    _evaluation_axis(svg, across, most, 290, width < NARROW)
    for n, study in enumerate(comparison.studies):
        svg.polyline(_score_steps(study, across, up), _line_class(n))
    return svg


def _estimate_row(svg: Svg, scale: Scale, e: ParameterEstimate, y: float) -> None:
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


def _estimate_scale(estimates: Sequence[ParameterEstimate], start: float, end: float) -> Scale:
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


def _score_steps(study: ComparedStudy, across: Scale, up: Scale) -> list[tuple[float, float]]:
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


def _evaluation_axis(svg: Svg, across: Scale, most: int, y: float, narrow: bool) -> None:
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


def _line_class(n: int) -> str:
    return f"line{n % LINE_CLASSES}" + (" again" if n >= LINE_CLASSES else "")


def _short_label(name: str) -> str:
    """Return the end of a long label, where the names of folders differ."""
    return name if len(name) <= MOST_LETTERS else f"…{name[-MOST_LETTERS + 1 :]}"


def constant_chart_words(comparison: StudyComparison, gene: str) -> str:
    """Return the alternative text of a chart of constants."""
    texts = []
    for study in comparison.studies:
        e = comparison.estimate(study, gene)
        if e is None:
            continue
        texts.append(f"{study.label}: {e.text}")
    return f"{label(gene, found_unit(comparison, gene))}. {'; '.join(texts)}."


def found_unit(comparison: StudyComparison, gene: str) -> str:
    """Return the unit of a constant; empty for a pure number."""
    found = (comparison.estimate(study, gene) for study in comparison.studies)
    return next(e.unit for e in found if e is not None)


def write_comparison(comparison: StudyComparison, path: Path) -> Path:
    """Write the page and return its path."""
    write_file(path, render_comparison(comparison).encode())
    return path


def render_comparison(comparison: StudyComparison) -> str:
    """Return the page as text; equal comparisons give the same bytes."""
    values = {
        "title": f"{len(comparison.studies)} studies",
        "lead": ", ".join(study.label for study in comparison.studies),
        "caveats": [
            f"{study.label}: {text}"
            for study in comparison.studies
            for text in study.results.caveats
        ],
        "labels": [study.label for study in comparison.studies],
        "constants": constant_rows(comparison),
        "pictures": [_constant_picture(comparison, gene) for gene in comparison.genes],
        "convergence": _score_picture(comparison),
        "outcomes": outcome_rows(comparison.studies),
        "settings": setting_rows(comparison),
        "reasons": reason_rows(comparison),
        "json": json.dumps(comparison.as_dict(), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }
    return filled("comparison.html.j2", values)


def constant_rows(comparison: StudyComparison) -> list[tuple[Markup, list[str]]]:
    """Return each constant, and its estimate with interval in every study."""
    return [
        (
            symbol(gene, found_unit(comparison, gene)),
            [estimate_text(comparison.estimate(study, gene)) for study in comparison.studies],
        )
        for gene in comparison.genes
    ]


def estimate_text(e: ParameterEstimate | None) -> str:
    """Return an estimate as ``10.1 (9.8 to 10.4) kPa``, with a star if it may not be quoted."""
    if e is None:
        return "not searched"
    if e.estimate is None:
        return "not estimated"
    return e.text + ("" if e.quotable else " *")


def outcome_rows(studies: Sequence[ComparedStudy]) -> list[tuple[str, list[str]]]:
    """Return scores, evaluations, time and state, one text for each study."""

    def score(study: ComparedStudy, name: str) -> str:
        scores = study.results.best_score
        return number(None if scores is None else scores.get(name), 4)

    rows = [
        (title, [score(study, name) for study in studies])
        for title, name in (("Jaccard", "jc"), ("MHD, mm", "mhd_mm"), ("GSF", "gsf"))
    ]
    ended = [count(len(study.lowest_scores)) for study in studies]
    return [
        *rows,
        ("Evaluations", ended),
        ("Strategy", [study.results.spec.search.strategy for study in studies]),
        ("Wall time", [duration(study.results.wall_s) for study in studies]),
        ("State", [study.results.state for study in studies]),
    ]


def setting_rows(comparison: StudyComparison) -> list[tuple[str, list[str]]]:
    """Return the settings that differ, one text for each study."""
    return [
        (key, [_alternative_text(v) for v in values]) for key, values in comparison.settings.items()
    ]


def reason_rows(comparison: StudyComparison) -> list[str]:
    """Return a sentence for each study and each reason against quoting some of its estimates."""
    rows = []
    for study in comparison.studies:
        estimates = study.results.estimates.values()
        answers = {e.gene: e.quotability for e in estimates if e.quotability is not None}
        rows += [
            f"{study.label}, {listed([f'{n} ({end})' if end else n for n, end in names])}: {why}."
            for names, why in names_by_reason(answers)
        ]
    return rows


def _constant_picture(comparison: StudyComparison, gene: str) -> Picture:
    return chart(partial(constant_chart, comparison, gene), constant_chart_words(comparison, gene))


def _score_picture(comparison: StudyComparison) -> Picture | None:
    ends = [s.lowest_scores[-1] for s in comparison.studies if s.lowest_scores]
    if not any(map(math.isfinite, ends)):
        return None
    alt = "; ".join(
        f"{s.label}: {number(s.lowest_scores[-1])} after {len(s.lowest_scores)} evaluations"
        for s in comparison.studies
        if s.lowest_scores
    )
    return chart(partial(score_chart, comparison), f"Lowest {comparison.axis}. {alt}.")


def _alternative_text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_alternative_text(v)}" for key, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_alternative_text(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)

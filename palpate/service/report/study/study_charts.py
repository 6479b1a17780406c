"""Charts of a study's page: the progress of the search, its result, and the posterior.

Dots have the numbers of their evaluations, so that the page's script can name the candidate under
the pointer. The posterior of the constants is a corner plot by matplotlib, which is loaded only
when it is drawn; all other charts are SVG.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

from palpate.service.number_formatting import label, number
from palpate.service.report.drawing.svg import (
    Mark,
    Scale,
    Svg,
    horizontal_axis,
    legend,
    scale_between,
    spans_decades,
    text_width,
    vertical_axis,
)
from palpate.service.report.page.page_elements import Picture, picture
from palpate.service.results.posterior_samples import constants_with_samples, draw_samples
from palpate.service.results.result_records import StudyResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHADES = 5  # shades of dots in a scatter plot, from the first generation to the last
STAGES = 6  # number of stage colours in the style sheet
NARROW = 600.0


@dataclass(frozen=True)
class EvaluationPoint:
    """One evaluation: generation from 0, parameters as in the file, score (+inf: failed)."""

    generation: int
    genes: Mapping[str, float]
    score: float


@dataclass(frozen=True)
class SearchedParameter:
    """A searched parameter for the charts, in the unit of the study file.

    Parameters
    ----------
    name : str
        Name in the study file.
    label : str
        Axis label, with its unit.
    lower, upper : float
        Bounds of the search.
    estimate, target : float or None
        None if there is none, or it is unknown.
    interval : (float, float) or None
        90 % interval; None if it is unknown.
    """

    name: str
    label: str
    lower: float
    upper: float
    estimate: float | None
    target: float | None
    interval: tuple[float, float] | None = None


def convergence_chart(
    points: Sequence[EvaluationPoint],
    best: Sequence[float],
    mean: Sequence[float],
    width: float,
    axis: str = "GSF",
) -> Svg:
    """Draw the best and mean score of each generation against the evaluations.

    Infinite scores are off the axis: identical volumes (-inf) are drawn as triangles along the
    bottom, failures (+inf) as crosses along the top.
    """
    svg = Svg(width, 330.0)
    last = max(len(best), *(p.generation + 1 for p in points))
    marks: list[tuple[Mark, str, str]] = [("dot", "dot evaluation", "evaluation")]
    infinite = {value for p in points if math.isinf(value := p.score)}
    if -math.inf in infinite:
        marks.append(("triangle", "identical", "identical to the target (−∞)"))
    if math.inf in infinite:
        marks.append(("cross", "failed", "failed"))
    marks += [("dashed", "mean", "mean of the generation"), ("line", "best", "lowest so far")]
    top = 10 + legend(svg, marks, 54, 12, width) + 6
    across = Scale(0.5, last + 0.5, 54, width - 10)
    low, high = _limits([s for s in (*(p.score for p in points), *best, *mean) if math.isfinite(s)])
    up = scale_between(low, high, 286, top)
    vertical_axis(svg, up, 54, f"{axis}, lower is better", width - 10)
    horizontal_axis(svg, across, 286, "generation", min(12, last, round(width / 45)))
    places = _beside(points, across)
    groups: dict[str, list[int]] = {"evaluation": [], "identical": [], "failed": []}
    for index, p in enumerate(points):
        kind = {-math.inf: "identical", math.inf: "failed"}.get(p.score, "evaluation")
        groups[kind].append(index)
    dots = groups["evaluation"]
    svg.dots([(places[i], up.at(points[i].score)) for i in dots], "evaluation", dots)
    for kind, mark, y in (("identical", "triangle", 283.0), ("failed", "cross", top)):
        for index in groups[kind]:
            svg.mark(mark, places[index], y, kind, 3.5)  # type: ignore[arg-type]
    steps = [across.at(n + 1) for n in range(len(best))]
    svg.polyline(zip(steps, (_finite(up, m) for m in mean), strict=True), "mean")
    heights = [_finite(up, max(b, low)) for b in accumulate(best, min)]
    svg.polyline(zip(steps, heights, strict=True), "best")
    svg.dots(
        [(x, y) for x, y in zip(steps, heights, strict=True) if math.isfinite(y)], "best-so-far"
    )
    return svg


def range_chart(
    parameters: Sequence[SearchedParameter], cloud: Mapping[str, Sequence[float]], width: float
) -> Svg:
    """Draw estimates and targets between the bounds of the search.

    Parameters
    ----------
    parameters : sequence of SearchedParameter
        One row each.
    cloud : mapping of str to sequence of float
        Values of good evaluations by name, drawn faintly.
    width : float
    """
    narrow = width < NARROW
    left = 8.0 if narrow else 20 + max(text_width(p.label, 14) for p in parameters)
    row_px = 74.0 if narrow else 62.0
    svg = Svg(width, 0)
    items: list[tuple[Mark, str, str]] = [("dot", "dot estimate", "estimate")]
    if any(p.interval for p in parameters):
        items.append(("box", "interval", "interval"))
    if any(p.target is not None for p in parameters):
        items.append(("diamond", "target", "target"))
    items.append(("stroke", "cloud", "best tenth of evaluations"))
    y = 12 + legend(svg, items, left, 12, width)
    for parameter in parameters:
        if narrow:
            svg.text(left, y + 14, parameter.label, class_="name")
        else:
            svg.text(
                left - 18, y + row_px / 2 + 4, parameter.label, text_anchor="end", class_="name"
            )
        centre = y + row_px / 2 + (10 if narrow else 0)
        _range_row(svg, parameter, cloud.get(parameter.name, ()), left, width - 10, centre)
        y += row_px
    svg.height = y + 6
    return svg


def scatter_chart(
    parameter: SearchedParameter,
    points: Sequence[EvaluationPoint],
    generations: int,
    width: float = 470.0,
    axis: str = "GSF",
) -> Svg:
    """Draw scores against one parameter; a narrow valley means that the images determine it."""
    svg = Svg(width, 270.0)
    lower, upper = _with_room((parameter.lower, parameter.upper), 0.02)
    across = scale_between(lower, upper, 54, width - 10)
    finite = [p.score for p in points if math.isfinite(p.score)]
    low, high = _limits(finite)
    up = scale_between(low, high, 226, 12)
    vertical_axis(svg, up, 54, axis, width - 10, 5)
    horizontal_axis(svg, across, 226, parameter.label, 6, 12)
    for shade in range(SHADES):
        own = [
            i
            for i, p in enumerate(points)
            if math.isfinite(p.score) and _shade(p.generation, generations) == shade
        ]
        places = [(across.at(points[i].genes[parameter.name]), up.at(points[i].score)) for i in own]
        svg.dots(places, f"age{shade}", own)
    if parameter.target is not None:
        x = across.at(parameter.target)
        svg.add("path", d=f"M{x:.1f} 12V226", class_="target-line")
    identical = [p.genes[parameter.name] for p in points if p.score == -math.inf]
    for value in identical:
        svg.mark("triangle", across.at(value), 223, "identical", 4)
    if parameter.estimate is not None:
        lowest = low if identical else min(finite, default=low)
        svg.mark("ring", across.at(parameter.estimate), up.at(lowest), "ring", 7)
    return svg


def stage_chart(seconds: Mapping[str, float], width: float) -> Svg:
    """Draw the shares of the evaluation time by stage."""
    svg = Svg(width, 0)
    items: list[tuple[Mark, str, str]] = [
        ("box", f"stage{k % STAGES}", name) for k, name in enumerate(seconds)
    ]
    top = 12 + legend(svg, items, 0, 12, width)
    total, left = sum(seconds.values()), 0.0
    for index, (name, spent) in enumerate(seconds.items()):
        share = spent / total if total > 0 else 0.0
        place = {"x": left * width, "y": top, "width": share * width, "height": 30.0}
        svg.titled(f"{name}: {share:.1%}", "rect", class_=f"stage{index % STAGES}", **place)
        if share * width > 44:
            centred = {"text_anchor": "middle", "class_": f"on-stage{index % STAGES}"}
            svg.text((left + share / 2) * width, top + 20, f"{share:.0%}", **centred)
        left += share
    svg.height = top + 34
    return svg


def _range_row(
    svg: Svg,
    parameter: SearchedParameter,
    cloud: Sequence[float],
    left: float,
    right: float,
    y: float,
) -> None:
    """Draw one parameter as a bar from bound to bound with its marks and numbers."""
    scale = scale_between(parameter.lower, parameter.upper, left + 6, right - 6)
    svg.add("path", d=f"M{left + 6:.1f} {y:.1f}H{right - 6:.1f}", class_="track")
    if parameter.interval is not None:
        ends = [scale.at(min(max(v, parameter.lower), parameter.upper)) for v in parameter.interval]
        box = {"x": ends[0], "y": y - 7, "width": max(2.0, ends[1] - ends[0]), "height": 14.0}
        svg.add("rect", class_="interval", rx=3, **box)
    for value in cloud:
        svg.mark("stroke", scale.at(value), y, "cloud", 5)
    svg.text(left, y + 22, number(parameter.lower), class_="tick")
    svg.text(right, y + 22, number(parameter.upper), class_="tick", text_anchor="end")
    if parameter.target is not None:
        svg.mark("diamond", scale.at(parameter.target), y, "target", 6)
    if parameter.estimate is not None:
        x = scale.at(parameter.estimate)
        svg.mark("dot", x, y, "dot estimate", 5.5)
        beside = min(max(x, left + 24), right - 24)
        svg.text(
            beside, y - 11, number(parameter.estimate, 3), text_anchor="middle", class_="value"
        )


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """Return an interval around finite values, with margins."""
    low, high = (min(values), max(values)) if values else (-1.0, 0.0)
    if low < high:
        return _with_room((low, high), 0.06)
    room = max(1.0, abs(high)) * 0.06
    return low - room, high + room


def _with_room(limits: tuple[float, float], share: float) -> tuple[float, float]:
    """Return limits widened by a fraction of the axis, which may be logarithmic."""
    low, high = limits
    if spans_decades(low, high):
        factor = (high / low) ** share
        return low / factor, high * factor
    return low - share * (high - low), high + share * (high - low)


def _finite(scale: Scale, value: float) -> float:
    return scale.at(value) if math.isfinite(value) else math.nan


def _shade(generation: int, generations: int) -> int:
    return min(SHADES - 1, SHADES * generation // max(1, generations))


def _beside(points: Sequence[EvaluationPoint], across: Scale) -> list[float]:
    """Return positions of points, spread within a generation to make equal scores visible."""
    sizes: dict[int, int] = {}
    for p in points:
        sizes[p.generation] = sizes.get(p.generation, 0) + 1
    done: dict[int, int] = {}
    places = []
    for p in points:
        k, n = done.get(p.generation, 0), sizes[p.generation]
        done[p.generation] = k + 1
        shift = -0.28 + 0.56 * k / (n - 1) if n > 1 else 0.0
        places.append(across.at(p.generation + 1 + shift))
    return places


POSTERIOR_DRAWS = 20_000


def posterior_figure(results: StudyResults, constants: Sequence[str] | None = None) -> "Figure":
    """Draw the posterior of the constants as a corner plot.

    Parameters
    ----------
    results : StudyResults
    constants : sequence of str, optional
        Default: all searched ones.

    Raises
    ------
    InputError
        If a constant is unknown or has no interval, with the reason.
    """
    # Loads matplotlib, which most pages do not need.
    from palpate.service.report.drawing.matplotlib_figures import CornerVariable, corner_plot

    samples = draw_samples(results, POSTERIOR_DRAWS, constants=constants)
    shown = [e for e in results.estimates.values() if e.gene in samples]
    return corner_plot(
        [
            CornerVariable(label(e.gene, e.unit), samples[e.gene], e.interval, e.estimate, e.target)
            for e in shown
            if e.interval is not None and e.estimate is not None
        ]
    )


def posterior_picture(results: StudyResults) -> Picture | None:
    """Draw the constants with intervals; None if there are fewer than two."""
    known = constants_with_samples(results)
    if len(known) < 2:
        return None
    alt = "; ".join(
        f"{label(e.gene, e.unit)}: {number(e.estimate)}, {number(e.interval[0])} to "
        f"{number(e.interval[1])}"
        for e in (results.estimates[name] for name in known)
        if e.interval is not None
    )
    targets = any(results.estimates[name].target is not None for name in known)
    caption = (
        "Remaining uncertainty. Contours contain 50 % and 90 % of the probability; shaded "
        "ranges are the 90 % intervals. A slanted contour shows that errors of the two "
        "constants can compensate. Line and dot: estimate"
        + ("; dashed line and diamond: target." if targets else ".")
    )
    return picture(posterior_figure(results, known), f"Posterior. {alt}.", caption)

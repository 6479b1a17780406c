"""Draws the charts of a study's page: how the search went and where it ended."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from service.formatting import number
from service.report import palette
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure, legend, limits
from service.report.palette import BLUE, GREY, INK, SOFT_INK, VERMILION

Curve = NDArray[np.float64]
GSF_AXIS = "GSF, lower is better"

# How the marks look, as matplotlib's keyword arguments.
EVALUATION: Mapping[str, Any] = {
    "s": 12,
    "color": GREY,
    "alpha": 0.55,
    "linewidths": 0,
    "label": "evaluation",
}
_EDGE: Mapping[str, Any] = {"s": 26, "linewidths": 1.2, "clip_on": False, "zorder": 4}
IDENTICAL: Mapping[str, Any] = {
    **_EDGE,
    "marker": "v",
    "color": BLUE,
    "label": "identical to the target (−∞)",
}
FAILED: Mapping[str, Any] = {**_EDGE, "marker": "x", "color": VERMILION, "label": "failed"}
MEAN: Mapping[str, Any] = {
    "color": SOFT_INK,
    "linewidth": 1.4,
    "linestyle": (0, (4, 3)),
    "label": "mean of the generation",
}
BEST_SO_FAR: Mapping[str, Any] = {
    "color": BLUE,
    "linewidth": 2.2,
    "marker": "o",
    "markersize": 4.5,
    "label": "best so far",
}
ESTIMATE: Mapping[str, Any] = {"marker": "o", "markersize": 8, "color": BLUE}
TARGET: Mapping[str, Any] = {
    "marker": "D",
    "markerfacecolor": "white",
    "markeredgecolor": INK,
    "markeredgewidth": 1.4,
}
RING: Mapping[str, Any] = {
    "s": 80,
    "facecolors": "none",
    "edgecolors": VERMILION,
    "linewidths": 1.8,
    "zorder": 5,
    "clip_on": False,
}


@dataclass(frozen=True)
class EvaluationPoint:
    """One evaluation: its generation from 0, parameters at the door, and GSF (+inf: failed)."""

    generation: int
    genes: Mapping[str, float]
    gsf: float


@dataclass(frozen=True)
class SearchedParameter:
    """A searched parameter as the charts show it, in its unit at the door.

    Parameters
    ----------
    name : str
        As in the study file.
    label : str
        For a reader, with its unit.
    lower, upper : float
        Bounds of the search.
    estimate, target : float or None
        None where there is none, or none is known.
    """

    name: str
    label: str
    lower: float
    upper: float
    estimate: float | None
    target: float | None


def convergence(
    points: Sequence[EvaluationPoint], best: Sequence[float], mean: Sequence[float]
) -> Figure:
    """Draw the best and mean score of each generation over all evaluations.

    Infinite scores have no place on the axis: identical volumes (-inf) are drawn as
    triangles along the bottom, failures (+inf) as crosses along the top.
    """
    drawn = figure(10.4, 3.7)
    axes = calm(drawn.subplots())
    numbers = np.array([p.generation + 1 for p in points], dtype=float)
    scores = np.array([p.gsf for p in points], dtype=float)
    spread = _beside(numbers)
    low, high = limits([s for s in (*scores, *best, *mean) if math.isfinite(s)] or [-1.0, 0.0])
    axes.set(ylim=(low, high), xlabel="generation", ylabel=GSF_AXIS)
    axes.set_xlim(0.5, max(len(best), int(numbers.max(initial=1.0))) + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    finite = np.isfinite(scores)
    axes.scatter(spread[finite], scores[finite], **EVALUATION)
    for edge, value, style in ((low, -math.inf, IDENTICAL), (high, math.inf, FAILED)):
        there = spread[scores == value]
        if there.size:
            axes.scatter(there, np.full(there.size, edge), **style)
    steps = np.arange(1, len(best) + 1)
    axes.plot(steps, _drawable(mean), **MEAN)
    axes.plot(steps, _reached(best, low), **BEST_SO_FAR)
    legend(axes, ncols=5)
    return drawn


def ranges(parameters: Sequence[SearchedParameter], cloud: Mapping[str, Sequence[float]]) -> Figure:
    """Draw estimates and targets between the bounds of the search.

    Parameters
    ----------
    parameters : sequence of SearchedParameter
        One row each.
    cloud : mapping of str to sequence of float
        Values of good evaluations by name, drawn faintly.
    """
    drawn = figure(10.4, 0.7 + 0.66 * len(parameters))
    axes = drawn.subplots()
    axes.spines[:].set_visible(False)
    axes.set(xlim=(-0.02, 1.02), ylim=(len(parameters) - 0.45, -0.6), xticks=[])
    labels = [p.label for p in parameters]
    axes.set_yticks(range(len(parameters)), labels, fontsize=TEXT_PT, color=INK)
    axes.tick_params(length=0, pad=12)
    for row, parameter in enumerate(parameters):
        _range(axes, row, parameter, cloud.get(parameter.name, ()))
    handles = [
        Line2D([], [], linewidth=0, label="estimate", **ESTIMATE),
        Line2D([], [], marker="|", color=GREY, linewidth=0, label="best tenth of evaluations"),
    ]
    if any(p.target is not None for p in parameters):
        handles.insert(1, Line2D([], [], linewidth=0, markersize=8, label="target", **TARGET))
    legend(axes, handles=handles)
    return drawn


def scatter(
    parameter: SearchedParameter, points: Sequence[EvaluationPoint], generations: int
) -> Figure:
    """Draw scores over one parameter: a narrow valley means that the images fix it."""
    drawn = figure(5.1, 2.9)
    axes = calm(drawn.subplots(), grid="both")
    scored = [p for p in points if math.isfinite(p.gsf)]
    ordered = sorted(scored, key=lambda p: p.generation)
    values, scores = [p.genes[parameter.name] for p in ordered], [p.gsf for p in ordered]
    ages: dict[str, Any] = {"cmap": palette.AGES, "vmin": 0, "vmax": max(1, generations - 1)}
    axes.scatter(
        values, scores, s=15, linewidths=0, alpha=0.85, c=[p.generation for p in ordered], **ages
    )
    if parameter.target is not None:
        axes.axvline(parameter.target, color=INK, linewidth=1.1, linestyle=(0, (2, 2)))
    low, high = limits([p.gsf for p in scored] or [-1.0, 0.0])
    axes.set_ylim(low, high)
    identical = [p.genes[parameter.name] for p in points if p.gsf == -math.inf]
    axes.scatter(identical, [low] * len(identical), marker="v", s=26, color=BLUE, clip_on=False)
    if parameter.estimate is not None:
        lowest = low if identical else min((p.gsf for p in scored), default=low)
        axes.scatter([parameter.estimate], [lowest], **RING)
    room = 0.02 * (parameter.upper - parameter.lower)
    axes.set_xlim(parameter.lower - room, parameter.upper + room)
    axes.set(xlabel=parameter.label, ylabel="GSF")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    return drawn


def stages(seconds: Mapping[str, float]) -> Figure:
    """Draw the shares of the time that evaluations took, stage by stage."""
    drawn = figure(10.4, 0.9)
    axes = drawn.subplots()
    axes.axis("off")
    total = sum(seconds.values())
    left = 0.0
    for index, (stage, spent) in enumerate(seconds.items()):
        share = spent / total if total > 0 else 0.0
        colour = palette.STAGES[index % len(palette.STAGES)]
        axes.barh(0, share, left=left, color=colour, height=0.5, edgecolor="white", label=stage)
        if share > 0.08:
            shade = "white" if colour in ("#0072b2", "#009e73") else INK
            centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL_PT}
            axes.text(left + share / 2, 0, f"{share:.0%}", color=shade, **centred)
        left += share
    axes.set(xlim=(0, 1), ylim=(-0.3, 0.3))
    legend(axes, ncols=len(seconds) or 1)
    return drawn


def _range(axes: Axes, row: int, parameter: SearchedParameter, cloud: Sequence[float]) -> None:
    """Draw one parameter as a bar from bound to bound with its marks and numbers."""
    lower, upper = parameter.lower, parameter.upper

    def place(value: float) -> float:
        return (value - lower) / (upper - lower)

    axes.plot([0, 1], [row, row], color=palette.RULE, linewidth=6, solid_capstyle="round", zorder=1)
    strokes = [place(value) for value in cloud]
    axes.plot(strokes, [row] * len(cloud), "|", color=GREY, alpha=0.6, markersize=9, zorder=2)
    for at, value, side in ((0.0, lower, "left"), (1.0, upper, "right")):
        bound: dict[str, Any] = {"ha": side, "va": "center", "fontsize": SMALL_PT}
        axes.text(at, row + 0.33, number(value), color=SOFT_INK, **bound)
    if parameter.target is not None:
        axes.plot(place(parameter.target), row, markersize=9, zorder=3, **TARGET)
    if parameter.estimate is not None:
        at = place(parameter.estimate)
        axes.plot(at, row, zorder=4, **ESTIMATE)
        side = "center" if 0.1 < at < 0.9 else ("left" if at <= 0.1 else "right")
        bold: dict[str, Any] = {"ha": side, "va": "center", "fontweight": "bold"}
        axes.text(at, row - 0.34, number(parameter.estimate), color=BLUE, fontsize=TEXT_PT, **bold)


def _reached(best: Sequence[float], low: float) -> Curve:
    """Put a best score of -inf on the lower edge; none yet (+inf) is a gap."""
    values = np.asarray(best, dtype=np.float64)
    return np.where(values == math.inf, np.nan, np.maximum(values, low))


def _drawable(scores: Sequence[float]) -> Curve:
    values = np.asarray(scores, dtype=np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _beside(numbers: Curve) -> Curve:
    """Shift points of one generation apart, evenly, so that equal scores stay visible."""
    shifted = numbers.copy()
    for value in np.unique(numbers):
        there = np.flatnonzero(numbers == value)
        shifted[there] += np.linspace(-0.28, 0.28, len(there)) if len(there) > 1 else 0.0
    return shifted

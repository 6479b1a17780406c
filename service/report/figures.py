"""The charts of a report: how the search went and what it found."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from service.report import palette
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure, legend, limits
from service.report.palette import BLUE, GREY, INK, SOFT_INK, VERMILION
from service.report.words import number

Curve = NDArray[np.float64]
GSF_AXIS = "GSF, lower is better"


@dataclass(frozen=True)
class Point:
    """One evaluation: its generation from 0, parameters at the door, and GSF (+inf: failed)."""

    generation: int
    genes: Mapping[str, float]
    gsf: float


@dataclass(frozen=True)
class Found:
    """What is known of one searched parameter, in its unit at the door.

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


def convergence(points: Sequence[Point], best: Sequence[float], mean: Sequence[float]) -> Figure:
    """Best and mean score of each generation over all evaluations.

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
    axes.scatter(spread[finite], scores[finite], s=12, color=GREY, alpha=0.55, linewidths=0,
                 label="evaluation")  # fmt: skip
    for edge, value, marker, colour, label in (
        (low, -math.inf, "v", BLUE, "identical to the target (−∞)"),
        (high, math.inf, "x", VERMILION, "failed"),
    ):
        there = spread[scores == value]
        if there.size:
            axes.scatter(there, np.full(there.size, edge), marker=marker, s=26, color=colour,
                         linewidths=1.2, label=label, clip_on=False, zorder=4)  # fmt: skip
    steps = np.arange(1, len(best) + 1)
    axes.plot(steps, _drawable(mean), color=SOFT_INK, linewidth=1.4, linestyle=(0, (4, 3)),
              label="mean of the generation")  # fmt: skip
    axes.plot(steps, _reached(best, low), color=BLUE, linewidth=2.2, marker="o",
              markersize=4.5, label="best so far")  # fmt: skip
    legend(axes, ncols=5)
    return drawn


def ranges(found: Sequence[Found], cloud: Mapping[str, Sequence[float]]) -> Figure:
    """Estimates and targets between the bounds of the search.

    Parameters
    ----------
    found : sequence of Found
        One row each.
    cloud : mapping of str to sequence of float
        Values of good evaluations by name, drawn faintly.
    """
    drawn = figure(10.4, 0.7 + 0.66 * len(found))
    axes = drawn.subplots()
    axes.spines[:].set_visible(False)
    axes.set(xlim=(-0.02, 1.02), ylim=(len(found) - 0.45, -0.6), xticks=[])
    axes.set_yticks(range(len(found)), [f.label for f in found], fontsize=TEXT_PT, color=INK)
    axes.tick_params(length=0, pad=12)
    for row, f in enumerate(found):
        _range(axes, row, f, cloud.get(f.name, ()))
    handles = [
        Line2D([], [], marker="o", color=BLUE, linewidth=0, markersize=8, label="estimate"),
        Line2D([], [], marker="|", color=GREY, linewidth=0, label="best tenth of evaluations"),
    ]
    if any(f.target is not None for f in found):
        handles.insert(1, _target_handle())
    legend(axes, handles=handles)
    return drawn


def scatter(found: Found, points: Sequence[Point], generations: int) -> Figure:
    """Scores over one parameter: a narrow valley means that the images fix it."""
    drawn = figure(5.1, 2.9)
    axes = calm(drawn.subplots(), grid="both")
    scored = [p for p in points if math.isfinite(p.gsf)]
    ordered = sorted(scored, key=lambda p: p.generation)
    axes.scatter(
        [p.genes[found.name] for p in ordered], [p.gsf for p in ordered], s=15, linewidths=0,
        c=[p.generation for p in ordered], cmap=palette.AGES, vmin=0, vmax=max(1, generations - 1),
        alpha=0.85,
    )  # fmt: skip
    if found.target is not None:
        axes.axvline(found.target, color=INK, linewidth=1.1, linestyle=(0, (2, 2)))
    low, high = limits([p.gsf for p in scored] or [-1.0, 0.0])
    axes.set_ylim(low, high)
    identical = [p.genes[found.name] for p in points if p.gsf == -math.inf]
    axes.scatter(identical, [low] * len(identical), marker="v", s=26, color=BLUE, clip_on=False)
    if found.estimate is not None:
        lowest = low if identical else min((p.gsf for p in scored), default=low)
        axes.scatter([found.estimate], [lowest], s=80, facecolors="none", edgecolors=VERMILION,
                     linewidths=1.8, zorder=5, clip_on=False)  # fmt: skip
    room = 0.02 * (found.upper - found.lower)
    axes.set(xlim=(found.lower - room, found.upper + room), xlabel=found.label, ylabel="GSF")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    return drawn


def stages(seconds: Mapping[str, float]) -> Figure:
    """Shares of the time that evaluations took, stage by stage."""
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
            axes.text(left + share / 2, 0, f"{share:.0%}", ha="center", va="center",
                      color=shade, fontsize=SMALL_PT)  # fmt: skip
        left += share
    axes.set(xlim=(0, 1), ylim=(-0.3, 0.3))
    legend(axes, ncols=len(seconds) or 1)
    return drawn


def _range(axes: Axes, row: int, f: Found, cloud: Sequence[float]) -> None:
    def place(value: float) -> float:
        return (value - f.lower) / (f.upper - f.lower)

    axes.plot([0, 1], [row, row], color=palette.RULE, linewidth=6, solid_capstyle="round", zorder=1)
    axes.plot([place(v) for v in cloud], [row] * len(cloud), "|", color=GREY, alpha=0.6,
              markersize=9, zorder=2)  # fmt: skip
    for at, value, side in ((0.0, f.lower, "left"), (1.0, f.upper, "right")):
        axes.text(at, row + 0.33, number(value), ha=side, va="center", color=SOFT_INK,
                  fontsize=SMALL_PT)  # fmt: skip
    if f.target is not None:
        axes.plot(place(f.target), row, "D", markersize=9, markerfacecolor="white",
                  markeredgecolor=INK, markeredgewidth=1.4, zorder=3)  # fmt: skip
    if f.estimate is not None:
        at = place(f.estimate)
        axes.plot(at, row, "o", markersize=8, color=BLUE, zorder=4)
        side = "center" if 0.1 < at < 0.9 else ("left" if at <= 0.1 else "right")
        axes.text(at, row - 0.34, number(f.estimate), ha=side, va="center", color=BLUE,
                  fontsize=TEXT_PT, fontweight="bold")  # fmt: skip


def _target_handle() -> Line2D:
    return Line2D([], [], marker="D", linewidth=0, markersize=8, markerfacecolor="white",
                  markeredgecolor=INK, label="target")  # fmt: skip


def _reached(best: Sequence[float], low: float) -> Curve:
    """A best score of -inf on the lower edge; none yet (+inf) is a gap."""
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

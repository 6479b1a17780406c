"""Charts of a diagnosis: how large the gap is, what the evidence says, how probable a cause is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from service.diagnosis.words import likely
from service.report import palette
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure, legend
from service.report.palette import BLUE, GREY, INK, ORANGE, SOFT_INK
from workers.diagnosis.summary import GapEstimate

WIDTH_IN = 10.4
BAR = 0.34


@dataclass(frozen=True)
class Judged:
    """A gap before and after.

    Parameters
    ----------
    title : str
        Of the scans that judge.
    before : GapEstimate
    after : GapEstimate or None
        None where no effect is accused.
    """

    title: str
    before: GapEstimate
    after: GapEstimate | None


@dataclass(frozen=True)
class Evidence:
    """What a refit gains over the nominal model, in nats; `field` is None if not tried."""

    title: str
    gain: float
    field: float | None


@dataclass(frozen=True)
class Cause:
    """A cause, how probable it is, and whether the 90 % set holds it."""

    title: str
    probability: float
    credible: bool


def gaps(rows: Sequence[Judged], noise_mm: float, effect: str) -> Figure:
    """Return bars of the gap with their intervals, and the noise that they stand on.

    Parameters
    ----------
    rows : sequence of Judged
    noise_mm : float
        Root mean square noise of one point, drawn as a line.
    effect : str
        Words for the effect in the legend; empty if there is none.
    """
    drawn = figure(WIDTH_IN, 0.9 + 0.72 * len(rows))
    axes = calm(drawn.subplots(), grid="x")
    for number, row in enumerate(rows):
        if row.after is None:
            _bar(axes, number, row.before, GREY)
        else:
            _bar(axes, number - BAR / 2 - 0.02, row.before, GREY)
            _bar(axes, number + BAR / 2 + 0.02, row.after, BLUE)
    axes.axvline(noise_mm, color=INK, linewidth=1.2, linestyle=(0, (2, 2)))
    axes.set_yticks(range(len(rows)), [row.title for row in rows], fontsize=TEXT_PT, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlabel="gap beyond the noise, mm")
    axes.set_xlim(0, 1.12 * max(noise_mm, *(row.before.high_mm for row in rows)))
    handles: list[Any] = [Patch(color=GREY, label="nominal model")]
    if effect:
        handles.append(Patch(color=BLUE, label=f"with {effect}"))
    handles.append(_dotted("noise of one point of the segmentation"))
    legend(axes, handles=handles)
    return drawn


def evidence(rows: Sequence[Evidence], threshold: float) -> Figure:
    """Return log evidence that each refit gains, and what a smooth field gains on top of it."""
    drawn = figure(WIDTH_IN, 0.9 + 0.36 * len(rows))
    axes = calm(drawn.subplots(), grid="x")
    for number, row in enumerate(rows):
        axes.barh(number, row.gain, height=0.6, color=BLUE)
        more = max(0.0, row.field or 0.0)
        if more:
            axes.barh(number, more, left=max(row.gain, 0.0), height=0.6, color=ORANGE)
        end = max(row.gain, 0.0) + more
        axes.annotate(
            f"{row.gain:.1f}" + (f" + {more:.1f}" if more else ""),
            (end, number),
            (4, 0),
            textcoords="offset points",
            va="center",
            color=SOFT_INK,
            fontsize=SMALL_PT,
        )
    axes.axvline(threshold, color=INK, linewidth=1.2, linestyle=(0, (2, 2)))
    axes.axvline(0, color=palette.RULE, linewidth=1)
    axes.set_yticks(range(len(rows)), [row.title for row in rows], fontsize=TEXT_PT, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.set(ylim=(len(rows) - 0.4, -0.6), xlabel="log evidence gained over the nominal model")
    axes.margins(x=0.12)
    handles = [
        Patch(color=BLUE, label="effect"),
        Patch(color=ORANGE, label="smooth misfit on top of it"),
        _dotted("alarm"),
    ]
    legend(axes, handles=handles)
    return drawn


def probabilities(causes: Sequence[Cause]) -> Figure:
    """Return bars of the probable causes, those of the 90 % set in colour."""
    drawn = figure(WIDTH_IN, 0.7 + 0.36 * len(causes))
    axes = calm(drawn.subplots(), grid="x")
    for number, cause in enumerate(causes):
        axes.barh(number, cause.probability, height=0.6, color=BLUE if cause.credible else GREY)
        axes.annotate(
            likely(cause.probability),
            (cause.probability, number),
            (4, 0),
            textcoords="offset points",
            va="center",
            color=SOFT_INK,
            fontsize=SMALL_PT,
        )
    axes.set_yticks(range(len(causes)), [c.title for c in causes], fontsize=TEXT_PT, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "25 %", "50 %", "75 %", "100 %"])
    axes.set(ylim=(len(causes) - 0.4, -0.6), xlim=(0, 1.1))
    legend(
        axes,
        handles=[
            Patch(color=BLUE, label="holds 90 % of the probability"),
            Patch(color=GREY, label="others"),
        ],
    )
    return drawn


def _bar(axes: Axes, at: float, gap: GapEstimate, colour: str) -> None:
    axes.barh(at, gap.gap_mm, height=BAR, color=colour)
    axes.plot(
        [gap.low_mm, gap.high_mm], [at, at], color=INK, linewidth=1.3, marker="|", markersize=6
    )
    axes.annotate(
        f"{gap.gap_mm:.2f}",
        (gap.high_mm, at),
        (6, 0),
        va="center",
        textcoords="offset points",
        color=SOFT_INK,
        fontsize=SMALL_PT,
    )


def _dotted(label: str) -> Line2D:
    return Line2D([], [], color=INK, linewidth=1.2, linestyle=(0, (2, 2)), label=label)

"""Charts of a scored set."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from service.blind.confusion import Confusion
from service.blind.probability import Bin
from service.diagnosis.words import spoken
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure, legend
from service.report.palette import BLUE, GREY, INK, ORANGE, RULE, SOFT_INK

WIDTH_IN = 10.4
COUNTS = LinearSegmentedColormap.from_list("counts", ["#ffffff", "#9fc3dc", "#0072b2"])
# A count on a cell darker than this is written in white.
DARK = 0.6
# A dot lower than this has its number above, clear of the axis.
LOW = 0.1


def heat_map(found: Confusion) -> Figure:
    """Rows of truths over columns of answers; answers that are right have a frame."""
    counts = np.array(found.counts)
    drawn = figure(WIDTH_IN, 1.6 + 0.34 * len(found.rows))
    axes = drawn.subplots()
    axes.imshow(counts, cmap=COUNTS, vmin=0, vmax=max(1, counts.max()), aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            shade = "white" if count > DARK * counts.max() else INK
            axes.text(column, row, str(count), ha="center", va="center", color=shade,
                      fontsize=TEXT_PT)  # fmt: skip
    for row, column in found.right:
        axes.add_patch(_frame(row, column))
    axes.set_xticks(range(len(found.columns)), [spoken(c) for c in found.columns], rotation=35,
                    ha="left", rotation_mode="anchor", fontsize=SMALL_PT, color=INK)  # fmt: skip
    axes.set_yticks(range(len(found.rows)), [spoken(r) for r in found.rows], fontsize=SMALL_PT,
                    color=INK)  # fmt: skip
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(counts.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(counts.shape[0] + 1) - 0.5, minor=True)
    axes.grid(True, which="minor", color=RULE, linewidth=0.7)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)
    return drawn


def curve(bins: Sequence[Bin]) -> Figure:
    """The share of statements that was true, over the probability that they were given."""
    drawn = figure(5.1, 4.4)
    axes = _square(drawn, "probability given", "share that was true")
    for b in bins:
        found = b.came_true
        if b.said is None or found.value is None or found.low is None or found.high is None:
            continue
        axes.plot([b.said, b.said], [found.low, found.high], color=GREY, linewidth=1.3)
        axes.plot(b.said, found.value, "o", color=BLUE, markersize=7)
        below = -9 if found.value > LOW else 5
        axes.annotate(f"{found.count}", (b.said, found.value), (6, below), color=SOFT_INK,
                      textcoords="offset points", fontsize=SMALL_PT)  # fmt: skip
    return drawn


def shrinkage(
    held_out: Sequence[tuple[float, float]], inside: Sequence[tuple[float, float]]
) -> Figure:
    """Claimed over true shrinkage, as pairs (claimed, true)."""
    drawn = figure(5.1, 4.4)
    axes = _square(drawn, "true shrinkage", "claimed shrinkage")
    _dots(axes, inside, ORANGE, "s", "on the scans fitted")
    _dots(axes, held_out, BLUE, "o", "on unseen scans")
    low = min([0.0, *(min(pair) for pair in [*held_out, *inside])]) - 0.05
    axes.set(xlim=(max(low, -1.0), 1.05), ylim=(max(low, -1.0), 1.05))
    legend(axes, ncols=2)
    return drawn


def gaps(before: Sequence[tuple[float, float]], after: Sequence[tuple[float, float]],
         floor: float | None) -> Figure:  # fmt: skip
    """Claimed over true gap in mm, as pairs (claimed, true)."""
    drawn = figure(5.1, 4.4)
    axes = _square(drawn, "true gap, mm", "claimed gap, mm")
    most = 1.08 * max([0.1, *(max(pair) for pair in [*before, *after])])
    if floor is not None:
        axes.axvline(floor, color=INK, linewidth=1.1, linestyle=(0, (2, 2)))
    _dots(axes, before, GREY, "o", "nominal model")
    _dots(axes, after, BLUE, "s", "with the effect")
    axes.set(xlim=(0, most), ylim=(0, most))
    axes.plot([0, most], [0, most], color=RULE, linewidth=1.2, zorder=0)
    handles: list[Line2D] = [_dot(GREY, "o", "nominal model"), _dot(BLUE, "s", "with the effect")]
    if floor is not None:
        handles.append(Line2D([], [], color=INK, linewidth=1.1, linestyle=(0, (2, 2)),
                              label="floor"))  # fmt: skip
    legend(axes, handles=handles, ncols=3)
    return drawn


def _square(drawn: Figure, across: str, up: str) -> Axes:
    axes = calm(drawn.subplots(), grid="both")
    axes.plot([-1, 1], [-1, 1], color=RULE, linewidth=1.2, zorder=0)
    axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel=across, ylabel=up)
    return axes


def _dots(axes: Axes, pairs: Sequence[tuple[float, float]], colour: str, marker: str,
          label: str) -> None:  # fmt: skip
    axes.plot([t for _, t in pairs], [c for c, _ in pairs], marker, color=colour, markersize=6,
              alpha=0.85, label=label)  # fmt: skip


def _dot(colour: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], color=colour, marker=marker, linewidth=0, markersize=6, label=label)


def _frame(row: int, column: int) -> Rectangle:
    return Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, edgecolor=INK, linewidth=1.6,
                     zorder=3)  # fmt: skip

"""Charts of a scored set."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from palpate.service.blind.answer_statistics import Confusion
from palpate.service.diagnosis.diagnosis_words import spoken
from palpate.service.report.drawing.colours import BLUE, GREY, INK, ORANGE, RULE
from palpate.service.report.drawing.matplotlib_figures import (
    SMALL_PT,
    TEXT_PT,
    calm,
    figure,
    legend,
)

Pair = tuple[float, float]
WIDTH_IN = 10.4
CENTRED: Mapping[str, Any] = {"ha": "center", "va": "center"}
SLANTED: Mapping[str, Any] = {"rotation": 35, "ha": "left", "rotation_mode": "anchor"}
FRAME: Mapping[str, Any] = {"fill": False, "edgecolor": INK, "linewidth": 1.6, "zorder": 3}
FLOOR: Mapping[str, Any] = {"color": INK, "linewidth": 1.1, "linestyle": (0, (2, 2))}
COUNTS = LinearSegmentedColormap.from_list("counts", ["#ffffff", "#9fc3dc", "#0072b2"])
# Counts on cells darker than this are white.
DARK = 0.6


def heat_map(table: Confusion) -> Figure:
    """Draw a table of truths (rows) and answers (columns); with correct answers framed."""
    counts = np.array(table.counts)
    drawn = figure(WIDTH_IN, 1.6 + 0.34 * len(table.rows))
    axes = drawn.subplots()
    axes.imshow(counts, cmap=COUNTS, vmin=0, vmax=max(1, counts.max()), aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            shade = "white" if count > DARK * counts.max() else INK
            axes.text(column, row, str(count), color=shade, fontsize=TEXT_PT, **CENTRED)
    for row, column in table.right:
        axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, **FRAME))
    columns, rows = ([spoken(name) for name in names] for names in (table.columns, table.rows))
    axes.set_xticks(range(len(columns)), columns, fontsize=SMALL_PT, color=INK, **SLANTED)
    axes.set_yticks(range(len(rows)), rows, fontsize=SMALL_PT, color=INK)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(counts.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(counts.shape[0] + 1) - 0.5, minor=True)
    axes.grid(True, which="minor", color=RULE, linewidth=0.7)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)
    return drawn


def shrinkage(held_out: Sequence[Pair], inside: Sequence[Pair]) -> Figure:
    """Draw claimed against true shrinkage, from pairs (claimed, true)."""
    drawn = figure(5.1, 4.4)
    axes = _square(drawn, "true shrinkage", "claimed shrinkage")
    _dots(axes, inside, ORANGE, "s", "on the same scans")
    _dots(axes, held_out, BLUE, "o", "on unseen scans")
    low = min([0.0, *(min(pair) for pair in [*held_out, *inside])]) - 0.05
    axes.set(xlim=(max(low, -1.0), 1.05), ylim=(max(low, -1.0), 1.05))
    legend(axes, ncols=2)
    return drawn


def gaps(before: Sequence[Pair], after: Sequence[Pair], floor: float | None) -> Figure:
    """Draw claimed against true gap in mm, from pairs (claimed, true)."""
    drawn = figure(5.1, 4.4)
    axes = _square(drawn, "true gap, mm", "claimed gap, mm")
    most = 1.08 * max([0.1, *(max(pair) for pair in [*before, *after])])
    if floor is not None:
        axes.axvline(floor, **FLOOR)
    _dots(axes, before, GREY, "o", "nominal model")
    _dots(axes, after, BLUE, "s", "with the effect")
    axes.set(xlim=(0, most), ylim=(0, most))
    axes.plot([0, most], [0, most], color=RULE, linewidth=1.2, zorder=0)
    handles: list[Line2D] = [_dot(GREY, "o", "nominal model"), _dot(BLUE, "s", "with the effect")]
    if floor is not None:
        handles.append(Line2D([], [], label="floor", **FLOOR))
    legend(axes, handles=handles, ncols=3)
    return drawn


def _square(drawn: Figure, across: str, up: str) -> Axes:
    axes = calm(drawn.subplots(), grid="both")
    axes.plot([-1, 1], [-1, 1], color=RULE, linewidth=1.2, zorder=0)
    axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel=across, ylabel=up)
    return axes


def _dots(axes: Axes, pairs: Sequence[Pair], colour: str, marker: str, label: str) -> None:
    claimed, true = [c for c, _ in pairs], [t for _, t in pairs]
    axes.plot(true, claimed, marker, color=colour, markersize=6, alpha=0.85, label=label)


def _dot(colour: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], color=colour, marker=marker, linewidth=0, markersize=6, label=label)

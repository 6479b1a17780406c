"""Corner plots: every constant on the diagonal, every pair of them below it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from palpate.service.report.drawing.canvas import calm, figure
from palpate.service.report.drawing.palette import BLUE, INK, ORANGE
from palpate.storage.values import FloatArray

SIDE_IN = 2.05
BINS = 40
# Standard deviation of the smoothing, in bins; removes the noise of some thousand draws.
SMOOTHING = 2.0
SHARES = (0.9, 0.5)
# Fraction of the draws beyond the ends of an axis.
TAIL = 0.002


@dataclass(frozen=True, eq=False)
class CornerVariable:
    """One variable of a corner plot.

    Parameters
    ----------
    label : str
        Name with unit.
    draws : ndarray, shape (n,)
    interval : (float, float)
        Shaded on the diagonal.
    estimate : float
        Drawn as a line.
    target : float or None
        Drawn as a dashed line; None if the truth is unknown.
    """

    label: str
    draws: FloatArray
    interval: tuple[float, float]
    estimate: float
    target: float | None = None


def corner_plot(variables: Sequence[CornerVariable]) -> Figure:
    """Draw histograms on the diagonal, and below it contours around 50 % and 90 % of the draws."""
    count = len(variables)
    side = SIDE_IN * max(count, 1.6)
    drawn = figure(side, side * 0.94)
    grid = drawn.subplots(count, count, squeeze=False)
    for row, up in enumerate(variables):
        for column, across in enumerate(variables):
            axes = grid[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            calm(axes, grid="")
            if row == column:
                _histogram(axes, up)
            else:
                _contours(axes, across, up)
            _label(axes, across, up, row, column, row == count - 1)
    return drawn


def _histogram(axes: Axes, one: CornerVariable) -> None:
    low, high = _range(one)
    height, edges = np.histogram(one.draws, BINS, (low, high), density=True)
    axes.stairs(height, edges, color=BLUE, linewidth=1.2)
    axes.axvspan(*np.clip(one.interval, low, high), color=BLUE, alpha=0.16, linewidth=0)
    axes.axvline(one.estimate, color=BLUE, linewidth=1.2)
    if one.target is not None:
        axes.axvline(one.target, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    axes.set(xlim=(low, high), yticks=[])
    axes.spines["left"].set_visible(False)


def _contours(axes: Axes, across: CornerVariable, up: CornerVariable) -> None:
    limits = [_range(across), _range(up)]
    counts, x, y = np.histogram2d(across.draws, up.draws, BINS, limits)
    density = gaussian_filter(counts, SMOOTHING).T
    levels = _levels(density)
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in (x, y)]
    if levels[0] < levels[-1]:
        most = 1.001 * float(density.max())
        for level in levels:
            axes.contourf(*middles, density, [level, most], colors=[BLUE], alpha=0.18)
        axes.contour(*middles, density, levels, colors=[BLUE], linewidths=1.0)
    axes.plot(across.estimate, up.estimate, "o", color=BLUE, markersize=5)
    if across.target is not None and up.target is not None:
        axes.plot(across.target, up.target, "D", color=ORANGE, markersize=5)
    axes.set(xlim=limits[0], ylim=limits[1])


def _levels(density: FloatArray) -> list[float]:
    """Return the densities exceeded by `SHARES` of all draws, ascending."""
    ranked = np.sort(density.ravel())[::-1]
    held = np.cumsum(ranked) / max(float(ranked.sum()), 1e-300)
    return [float(ranked[np.searchsorted(held, share)]) for share in SHARES]


def _range(one: CornerVariable) -> tuple[float, float]:
    """Return the ends of an axis that contain nearly all draws, the estimate and the target."""
    known = [one.estimate, *one.interval, *np.quantile(one.draws, [TAIL, 1 - TAIL])]
    known += [] if one.target is None else [one.target]
    low, high = float(min(known)), float(max(known))
    room = 0.04 * (high - low) or 0.05 * max(abs(high), 1e-12)
    return low - room, high + room


def _label(
    axes: Axes, across: CornerVariable, up: CornerVariable, row: int, column: int, last: bool
) -> None:
    axes.xaxis.set_major_locator(MaxNLocator(4, prune="both"))
    if row != column:
        axes.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
    if last:
        axes.set_xlabel(across.label)
    else:
        axes.tick_params(labelbottom=False)
    if column == 0 and row > 0:
        axes.set_ylabel(up.label)
    elif column > 0:
        axes.tick_params(labelleft=False)

"""Where model and scan differ: points of an interface, seen from three sides."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure
from service.report.palette import INK, SOFT_INK
from service.report.slices import AXES
from storage.values import FloatArray

# Residuals within so many standard deviations of the noise are drawn grey.
SIGNIFICANT = 2.0
SMALLEST_RANGE_MM = 0.5
LEAST_RANGE_NOISES = 10.0
FAINT = "#d3d8de"
# Both ends are as dark as each other, and the middle is not white, which is no colour on paper.
SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#053c5e", "#0072b2", "#9fc3dc", "#c9c5bd", "#eeb083", "#c44e00", "#6b2500"]
)
# (across, up, along): columns of (x, y, z), and what a reader sees.
VIEWS = (
    (0, 1, "seen towards the chest wall"),
    (0, 2, "seen along y"),
    (1, 2, "seen along x"),
)
DOTS_PER_INCH = 180
POINT = 11.0


def range_mm(before: FloatArray, noise: FloatArray) -> float:
    """Return end of the colour scale: what 98 % of the significant residuals keep below."""
    loud = np.abs(before)[np.abs(before) >= SIGNIFICANT * noise]
    least = min(SMALLEST_RANGE_MM, LEAST_RANGE_NOISES * float(noise.max()))
    return max(least, float(np.quantile(loud, 0.98)) if loud.size else 0.0)


def sharpened(drawn: Figure) -> None:
    """Draw what is drawn as dots with `DOTS_PER_INCH`.

    A canvas remembers the resolution that it was made with, so it is made anew.
    """
    drawn.set_dpi(DOTS_PER_INCH)
    FigureCanvasSVG(drawn)


def residual_map(
    points: FloatArray,
    rows: dict[str, FloatArray],
    noise: FloatArray,
    most_mm: float,
) -> Figure:
    """Return signed residuals of one interface in one scan.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        In the scan at rest, in mm.
    rows : dict of str to ndarray, shape (k,)
        Residuals in mm by the title of their row, one colour scale for all.
    noise : ndarray, shape (k,)
        Standard deviation of each.
    most_mm : float
        End of the colour scale.
    """
    flat = not np.ptp(points[:, 2])
    views = ((0, 1, "in the plane of the section"),) if flat else VIEWS
    spans = np.ptp(points, axis=0) + (1.0 if flat else 8.0)
    per_in = sum(spans[across] for across, _, _ in views) / 8.6
    heights = [max(spans[up] for _, up, _ in views) / per_in] * len(rows)
    drawn = figure(10.4, sum(heights) + 0.55 * len(rows) + 0.2)
    sharpened(drawn)
    widths = [spans[across] for across, _, _ in views]
    grid = drawn.subplots(len(rows), len(views), squeeze=False, width_ratios=widths)
    scale = Normalize(-most_mm, most_mm)
    for number, (title, residual) in enumerate(rows.items()):
        for axes, (across, up, view) in zip(grid[number], views, strict=True):
            _scatter(axes, points[:, across], points[:, up], residual, noise, scale)
            axes.set_xlabel(f"{AXES[across]}, mm", fontsize=SMALL_PT)
            axes.set_ylabel(f"{AXES[up]}, mm", fontsize=SMALL_PT)
            if number == len(rows) - 1:
                axes.set_xlabel(f"{AXES[across]}, mm\n{view}", fontsize=SMALL_PT)
        grid[number, 0].set_title(title, fontsize=TEXT_PT, color=INK, loc="left")
    bar = drawn.colorbar(ScalarMappable(scale, SIGNED), ax=grid, aspect=30, pad=0.01, extend="both")
    bar.set_label("model outside (+) or inside (−), mm", fontsize=SMALL_PT, color=INK)
    bar.ax.tick_params(labelsize=SMALL_PT, colors=SOFT_INK)
    bar.outline.set_visible(False)
    return drawn


def _scatter(
    axes: Axes,
    across: FloatArray,
    up: FloatArray,
    residual: FloatArray,
    noise: FloatArray,
    scale: Normalize,
) -> None:
    calm(axes, grid="")
    loud = np.abs(residual) >= SIGNIFICANT * noise
    axes.scatter(
        across[~loud], up[~loud], s=0.6 * POINT, color=FAINT, linewidths=0, rasterized=True
    )
    order = np.flatnonzero(loud)[np.argsort(np.abs(residual[loud]), kind="stable")]
    axes.scatter(
        across[order],
        up[order],
        s=POINT,
        c=residual[order],
        cmap=SIGNED,
        norm=scale,
        linewidths=0,
        rasterized=True,
    )
    axes.set_aspect("equal")
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))

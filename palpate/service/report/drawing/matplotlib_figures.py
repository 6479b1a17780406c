"""Reproducible Matplotlib figures without global state: no pyplot, no display.

Text is kept as text in the fonts of the page, so figures are sharp at any size. A corner plot has
every constant on the diagonal, and every pair of them below it.
"""

import io
import re
import threading
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from palpate.service.report.drawing.colours import BLUE, INK, ORANGE, RULE, SOFT_INK, VERMILION
from palpate.storage.values import FloatArray

FONTS = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
TEXT_PT = 10.0
SMALL_PT = 9.0
GRID_EDGE = "#aab2bd"
NOTEBOOK_DPI = 110
# Colours of a figure, and the variables of the style sheet that follow light and dark.
_THEMED = {
    INK: "ink",
    SOFT_INK: "soft",
    RULE: "rule",
    GRID_EDGE: "axis",
    BLUE: "blue",
    ORANGE: "orange",
    VERMILION: "vermilion",
}

# A user's settings may ask for LaTeX, for which names such as E_fat and the sign % mean something
# else.
PLAIN_TEXT: Any = {"text.usetex": False}
# Matplotlib reads these from its global settings when saving.
_WRITING: Any = {"svg.fonttype": "none", "svg.hashsalt": "palpate"} | PLAIN_TEXT
_lock = threading.Lock()
# Names of clips and markers are hashes of exact coordinates, which the layout does not always
# reproduce.
_NAMED = re.compile(r'\bid="([a-z][0-9a-f]{10})"')
_FONT_LIST = re.compile(r"'DejaVu Sans'(?:, (?:'[^']*'|[\w-]+))*")


class ShownFigure(Figure):
    """A figure that notebooks display without importing pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=NOTEBOOK_DPI)
        return buffer.getvalue()


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure with a transparent background."""
    made = ShownFigure(figsize=(width_in, height_in), layout="constrained", facecolor="none")
    FigureCanvasSVG(made)
    return made


def on_white(drawn: Figure) -> Figure:
    """Return the figure with a white background, for notebooks with any theme."""
    drawn.set_facecolor("white")
    return drawn


def calm(axes: Axes, *, grid: str = "y") -> Axes:
    """Remove the clutter of `axes`; `grid` is "x", "y", "both" or "" for none."""
    axes.set_facecolor("none")
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GRID_EDGE)
    axes.tick_params(colors=SOFT_INK, labelsize=SMALL_PT, length=3, width=0.8)
    axes.xaxis.label.set(color=INK, fontsize=TEXT_PT)
    axes.yaxis.label.set(color=INK, fontsize=TEXT_PT)
    axes.set_axisbelow(True)
    if grid:
        axes.grid(True, axis=grid, color=RULE, linewidth=0.7)  # type: ignore[arg-type]
    return axes


def legend(axes: Axes, **options: Any) -> None:
    """Draw a legend without a frame, above the axes."""
    place: dict[str, Any] = {
        "loc": "lower left",
        "bbox_to_anchor": (0.0, 1.0),
        "ncols": 4,
    } | options
    axes.legend(
        frameon=False,
        fontsize=SMALL_PT,
        labelcolor=SOFT_INK,
        borderaxespad=0.2,
        handletextpad=0.5,
        columnspacing=1.4,
        **place,
    )


def svg(drawn: Figure) -> str:
    """Return the figure as SVG text, reproducibly."""
    buffer = io.StringIO()
    with _lock, mpl.rc_context(_WRITING):
        for words in drawn.findobj(Text):
            words.set_usetex(False)
        drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    for n, name in enumerate(dict.fromkeys(_NAMED.findall(text))):
        text = text.replace(name, f"{name[0]}{n}")
    return _FONT_LIST.sub(FONTS, text)


def inline_svg(drawn: Figure, label: str, width_px: int, *, on_paper: bool = False) -> Markup:
    """Return the figure as an element of a page, in the colours of the page's style sheet.

    Its element names are made unique on the page. A figure `on_paper` keeps its own colours on
    white, because it has text on coloured cells.
    """
    text = svg(drawn)
    own = f"f{zlib.crc32(text.encode()):08x}"
    text = text[text.index("<svg") :]
    head, body = text[: text.index(">") + 1], text[text.index(">") + 1 :]
    box = re.search(r'viewBox="[^"]*"', head)
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'\bid="', f'id="{own}', body)
    body = re.sub(r'(href="#|url\(#)', rf"\g<1>{own}", body).replace("xlink:href", "href")
    for colour, variable in ({} if on_paper else _THEMED).items():
        body = body.replace(colour, f"var(--{variable})")
    return (
        Markup('<svg class="chart {}" {} style="max-width:{}px" role="img" aria-label="{}">')
    ).format(
        "paper" if on_paper else "drawn", Markup(box[0] if box else ""), width_px, label
    ) + Markup(body)


def limits(values: Sequence[float], margin: float = 0.06) -> tuple[float, float]:
    """Return an interval around finite values, with margins."""
    low, high = min(values), max(values)
    room = margin * (high - low) or max(1.0, abs(high)) * margin
    return low - room, high + room


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

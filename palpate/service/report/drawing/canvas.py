"""Reproducible matplotlib figures without global state: no pyplot, no display.

Text is kept as text in the fonts of the page, so figures are sharp at any size.
"""

import io
import re
import threading
import zlib
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from palpate.service.report.drawing.palette import BLUE, INK, ORANGE, RULE, SOFT_INK, VERMILION

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

# Matplotlib reads these two from its global settings when saving.
_WRITING: Any = {"svg.fonttype": "none", "svg.hashsalt": "palpate"}
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

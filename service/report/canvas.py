"""Makes figures without global state: no pyplot, no display, the same bytes every time.

Text stays text, in the fonts of the page, so a figure is sharp at any size.
"""

import base64
import io
import re
import threading
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from service.report.palette import INK, RULE, SOFT_INK

FONTS = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
TEXT_PT = 10.0
SMALL_PT = 9.0
GRID_EDGE = "#aab2bd"

# Matplotlib reads these two settings from its global ones when it writes.
_WRITING: Any = {"svg.fonttype": "none", "svg.hashsalt": "palpate"}
_lock = threading.Lock()
# Names of clips and markers are hashes of coordinates to the last bit, which the layout does
# not always repeat.
_NAMED = re.compile(r'\bid="([a-z][0-9a-f]{10})"')
_FONT_LIST = re.compile(r"'DejaVu Sans'(?:, (?:'[^']*'|[\w-]+))*")


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure on white."""
    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasSVG(made)
    return made


def calm(axes: Axes, *, grid: str = "y") -> Axes:
    """Take away from `axes` what says nothing; `grid` is "x", "y" or "both", or "" for none."""
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
    """Return the figure as text, the same for the same figure."""
    buffer = io.StringIO()
    with _lock, mpl.rc_context(_WRITING):
        drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    for n, name in enumerate(dict.fromkeys(_NAMED.findall(text))):
        text = text.replace(name, f"{name[0]}{n}")
    return _FONT_LIST.sub(FONTS, text)


def data_uri(drawn: Figure) -> str:
    """Return the figure as the address of an image, for a page that needs no other file."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg(drawn).encode()).decode()


def limits(values: Sequence[float], margin: float = 0.06) -> tuple[float, float]:
    """Return an interval around finite values, with room at both ends."""
    low, high = min(values), max(values)
    room = margin * (high - low) or max(1.0, abs(high)) * margin
    return low - room, high + room

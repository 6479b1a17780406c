"""Maps of the gap: points of an interface, seen from three sides."""

from collections.abc import Mapping

import numpy as np

from palpate.service.report.drawing.colour_scale import SIGNED, ColourScale, colour_bar
from palpate.service.report.drawing.panel import BELOW_PX, LEFT_PX, Panel
from palpate.service.report.drawing.slices import AXES
from palpate.service.report.drawing.svg import Svg
from palpate.storage.values import FloatArray

# Residuals below this number of standard deviations are drawn grey.
SIGNIFICANT = 2.0
SMALLEST_RANGE_MM = 0.5
LEAST_RANGE_NOISES = 10.0
FAINT = "#d3d8de"
# (across, up): columns of (x, y, z), and the title of the view.
VIEWS = (
    (0, 1, "seen towards the chest wall"),
    (0, 2, "seen along y"),
    (1, 2, "seen along x"),
)
WIDTH_PX = 998.0
BAR_PX, HEAD_PX, LINE_PX = 100.0, 24.0, 16.0
# Margin around the points, relative to their largest extent.
MARGIN = 0.04
BAR_LABEL = "model outside (+) or inside (−), mm"
# Number of colour levels on either side of zero.
LEVELS = 64


def range_mm(before: FloatArray, noise: FloatArray) -> float:
    """Return the end of the colour scale: the 98 % quantile of the significant residuals."""
    loud = np.abs(before)[np.abs(before) >= SIGNIFICANT * noise]
    least = min(SMALLEST_RANGE_MM, LEAST_RANGE_NOISES * float(noise.max()))
    return max(least, float(np.quantile(loud, 0.98)) if loud.size else 0.0)


def residual_map(
    points: FloatArray, rows: Mapping[str, FloatArray], noise: FloatArray, most_mm: float
) -> Svg:
    """Return a map of the signed residuals of one interface in one scan.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points in the scan at rest, in mm.
    rows : mapping of str to ndarray, shape (k,)
        Residuals in mm by the title of their row, on one colour scale.
    noise : ndarray, shape (k,)
        Standard deviations in mm.
    most_mm : float
        End of the colour scale.
    """
    flat = not np.ptp(points[:, 2])
    views = ((0, 1, "in the plane of the section"),) if flat else VIEWS
    margin = MARGIN * float(np.ptp(points, axis=0).max())
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    room = WIDTH_PX - BAR_PX - LEFT_PX * len(views)
    per_mm = room / float(sum(high[across] - low[across] for across, _, _ in views))
    tallest = per_mm * float(max(high[up] - low[up] for _, up, _ in views))
    svg = Svg(WIDTH_PX, 0)
    colours = ColourScale(SIGNED, most_mm)
    bottom = 0.0
    for number, (title, residual) in enumerate(rows.items()):
        top, last = bottom + HEAD_PX, number == len(rows) - 1
        bottom = top + tallest + BELOW_PX
        svg.text(LEFT_PX, top - 9, title, class_="head")
        x = LEFT_PX
        for across, up, view in views:
            frame = (*_between(low, high, across), *_between(low, high, up))
            panel = Panel(frame, x, top + tallest - per_mm * (frame[3] - frame[2]), per_mm)
            panel.axes(svg, f"{AXES[across]}, mm", f"{AXES[up]}, mm", [view] if last else [])
            places = [
                (panel.across.at(x_mm), panel.up.at(y_mm))
                for x_mm, y_mm in points[:, [across, up]].tolist()
            ]
            _dots(svg, places, residual, noise, colours)
            x += LEFT_PX + per_mm * (frame[1] - frame[0])
    svg.height = bottom + LINE_PX
    colour_bar(
        svg, colours, WIDTH_PX - BAR_PX + 24, (HEAD_PX, bottom - BELOW_PX), BAR_LABEL, arrows=True
    )
    return svg


def _between(low: FloatArray, high: FloatArray, axis: int) -> tuple[float, float]:
    return float(low[axis]), float(high[axis])


def _dots(
    svg: Svg,
    places: list[tuple[float, float]],
    residual: FloatArray,
    noise: FloatArray,
    colours: ColourScale,
) -> None:
    """Draw points, those within the noise first and the largest residuals last."""
    loud = np.abs(residual) >= SIGNIFICANT * noise
    svg.dots([places[k] for k in np.flatnonzero(~loud).tolist()], "quiet")
    level = np.clip(np.rint(LEVELS * residual / colours.end), -LEVELS, LEVELS)
    shown = sorted(set(level[loud].tolist()), key=abs)
    for one, shade in zip(
        shown, colours.written(colours.end * np.array(shown) / LEVELS), strict=True
    ):
        own = np.flatnonzero(loud & (level == one)).tolist()
        svg.dots([places[k] for k in own], "loud", stroke=shade)

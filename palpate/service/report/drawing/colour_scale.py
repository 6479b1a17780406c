"""Colour scales of signed numbers, and their colour bars."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.service.report.drawing.palette import to_rgba
from palpate.service.report.drawing.raster import image_uri
from palpate.service.report.drawing.svg import Scale, Svg, tick_text
from palpate.storage.values import FloatArray

# Both ends are equally dark; the middle is not white, which would vanish on paper.
SIGNED = ("#053c5e", "#0072b2", "#9fc3dc", "#c9c5bd", "#eeb083", "#c44e00", "#6b2500")
BAR_PX = 14.0
# Minimum distance of ticks.
TICK_PX = 20.0
# Pixels of the image stretched over the bar.
BAR_DOTS = 128


@dataclass(frozen=True)
class ColourScale:
    """Colours of the numbers from -`end` to `end`.

    Parameters
    ----------
    stops : sequence of str
        Colours #rrggbb at equal distances; linear in sRGB between them.
    end : float
        Numbers beyond it have the colour of the nearest end.
    """

    stops: Sequence[str]
    end: float

    def at(self, values: FloatArray) -> FloatArray:
        """Return red, green and blue from 0 to 1, shape (..., 3)."""
        colours = np.array([to_rgba(stop)[:3] for stop in self.stops])
        places = np.linspace(-self.end, self.end, len(colours))
        return np.stack([np.interp(values, places, channel) for channel in colours.T], axis=-1)

    def written(self, values: FloatArray) -> list[str]:
        """Return the colours of numbers, shape (n,), as #rrggbb."""
        return [f"#{bytes(colour).hex()}" for colour in _bytes(self.at(values))]


def colour_bar(
    svg: Svg,
    colours: ColourScale,
    x: float,
    span: tuple[float, float],
    label: str,
    *,
    arrows: bool = False,
    strokes: Sequence[float] = (),
) -> None:
    """Draw a scale from top to bottom, with ticks and a label on its right.

    Parameters
    ----------
    svg : Svg
    colours : ColourScale
    x : float
        Left edge in pixels.
    span : tuple of float
        Upper and lower end in pixels.
    label : str
    arrows : bool
        Whether to draw pointed ends, for numbers beyond the scale.
    strokes : sequence of float
        Numbers marked across the bar.
    """
    top, bottom = span
    if arrows:
        low, high = colours.written(np.array([-colours.end, colours.end]))
        top, bottom = top + BAR_PX, bottom - BAR_PX
        for y, way, fill in ((top, -1, high), (bottom, 1, low)):
            tip = f"M{x:.1f} {y:.1f}h{BAR_PX:.1f}l{-BAR_PX / 2:.1f} {way * BAR_PX:.1f}z"
            svg.add("path", d=tip, fill=fill)
    column = _bytes(colours.at(np.linspace(-colours.end, colours.end, BAR_DOTS)))
    svg.add(
        "image",
        href=image_uri(np.insert(column, 3, 255, axis=1)[:, None]),
        preserveAspectRatio="none",
        x=x,
        y=top,
        width=BAR_PX,
        height=bottom - top,
    )
    scale = Scale(-colours.end, colours.end, bottom, top)
    for value in scale.ticks(max(2, min(10, int((bottom - top) / TICK_PX)))):
        y = scale.at(value)
        svg.add("path", d=f"M{x + BAR_PX:.1f} {y:.1f}h4", class_="axis")
        svg.text(x + BAR_PX + 8, y + 4, tick_text(value), class_="tick")
    for value in strokes:
        svg.add("path", d=f"M{x:.1f} {scale.at(value):.1f}h{BAR_PX:.1f}", class_="whisker")
    across, middle = x + BAR_PX + 52, (top + bottom) / 2
    turned = f"rotate(-90 {across:.1f} {middle:.1f})"
    svg.text(across, middle, label, text_anchor="middle", transform=turned)


def _bytes(colours: FloatArray) -> NDArray[np.uint8]:
    return np.rint(255 * colours).astype(np.uint8)

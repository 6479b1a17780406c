"""Colours of charts, tissues and signed numbers, with their tables and colour bars.

Readers with colour vision deficiency can distinguish them: charts use the colours of Okabe and
Ito (2008) and greys. Tissues differ in lightness as well as in hue, so that a page printed in grey
can still be read. A scale of signed numbers is equally dark at both ends.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from palpate.service.report.drawing.raster import image_uri
from palpate.service.report.drawing.svg import Scale, Svg, tick_text
from palpate.storage.values import FloatArray, Tissue

INK = "#1f2733"
SOFT_INK = "#5d6775"
RULE = "#d8dde4"
BLUE = "#0072b2"
ORANGE = "#e69f00"
VERMILION = "#c44e00"
GREY = "#8a94a1"
GREEN = "#009e73"
PINK = "#cc79a7"
# From pale to dark, for lengths.
SEQUENTIAL = ("#d9d4c7", "#e5b567", "#cf6f3a", "#9b2f58", "#43155e")

TISSUE_PALETTE: dict[Tissue, str] = {
    Tissue.AIR: "#ffffff",
    Tissue.FAT: "#f4e7c3",
    Tissue.GLANDULAR: "#a8326e",
    Tissue.SKIN: "#6d5647",
    Tissue.MUSCLE: "#d2694a",
    Tissue.LIGAMENT: "#86b4c9",
}
UNKNOWN_LABEL = "#000000"
# Surfaces in a viewer, lighter than the tissues of a slice.
INTERFACE_PALETTE = {"outline": "#e9d3b4", "glandular": "#c2628f"}


class Difference(IntEnum):
    """Classes of voxels in the comparison of target and best candidate."""

    OUTSIDE = 0
    BODY = 1
    BOTH = 2
    ONLY_TARGET = 3
    ONLY_BEST = 4


# Greys are translucent, to suit light and dark pages.
DIFFERENCE_PALETTE: dict[Difference, str] = {
    Difference.OUTSIDE: "#ffffff00",
    Difference.BODY: "#8a94a12e",
    Difference.BOTH: "#8a94a199",
    Difference.ONLY_TARGET: "#107ac0ff",
    Difference.ONLY_BEST: "#e69f00ff",
}


def colour_table(colours: Mapping[int, str]) -> NDArray[np.uint8]:
    """Return a table of 256 colours by label; other labels are black, air is transparent.

    Returns
    -------
    ndarray of uint8, shape (256, 4)
        Red, green, blue and opacity.
    """
    table = np.tile(np.asarray(to_rgba(UNKNOWN_LABEL)), (256, 1))
    for label, colour in colours.items():
        table[int(label)] = to_rgba(colour)
    table[0, 3] = 0.0
    return np.rint(255 * table).astype(np.uint8)


def to_rgba(colour: str) -> tuple[float, float, float, float]:
    """Return the components, 0 to 1, of a colour written #rrggbb or #rrggbbaa."""
    digits = colour.removeprefix("#").ljust(8, "f")
    r, g, b, a = (int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4, 6))
    return r, g, b, a


# Both ends are equally dark; the middle is not white, which would vanish on paper.
SIGNED = ("#053c5e", "#0072b2", "#9fc3dc", "#c9c5bd", "#eeb083", "#c44e00", "#6b2500")
COLOUR_BAR_PX = 14.0
# Minimum distance of ticks.
TICK_DISTANCE_PX = 20.0
# Pixels of the image stretched over the bar.
COLOUR_BAR_DOTS = 128


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
        return [f"#{bytes(colour).hex()}" for colour in _colour_bytes(self.at(values))]


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
        top, bottom = top + COLOUR_BAR_PX, bottom - COLOUR_BAR_PX
        for y, way, fill in ((top, -1, high), (bottom, 1, low)):
            side = COLOUR_BAR_PX
            tip = f"M{x:.1f} {y:.1f}h{side:.1f}l{-side / 2:.1f} {way * side:.1f}z"
            svg.add("path", d=tip, fill=fill)
    column = _colour_bytes(colours.at(np.linspace(-colours.end, colours.end, COLOUR_BAR_DOTS)))
    svg.add(
        "image",
        href=image_uri(np.insert(column, 3, 255, axis=1)[:, None]),
        preserveAspectRatio="none",
        x=x,
        y=top,
        width=COLOUR_BAR_PX,
        height=bottom - top,
    )
    scale = Scale(-colours.end, colours.end, bottom, top)
    for value in scale.ticks(max(2, min(10, int((bottom - top) / TICK_DISTANCE_PX)))):
        y = scale.at(value)
        svg.add("path", d=f"M{x + COLOUR_BAR_PX:.1f} {y:.1f}h4", class_="axis")
        svg.text(x + COLOUR_BAR_PX + 8, y + 4, tick_text(value), class_="tick")
    for value in strokes:
        svg.add("path", d=f"M{x:.1f} {scale.at(value):.1f}h{COLOUR_BAR_PX:.1f}", class_="whisker")
    across, middle = x + COLOUR_BAR_PX + 52, (top + bottom) / 2
    turned = f"rotate(-90 {across:.1f} {middle:.1f})"
    svg.text(across, middle, label, text_anchor="middle", transform=turned)


def _colour_bytes(colours: FloatArray) -> NDArray[np.uint8]:
    return np.rint(255 * colours).astype(np.uint8)

"""Charts as inline SVG, and panels that show a region of space to scale, with axes in mm.

Colours are classes of the page's style sheet, so charts follow light and dark mode; text stays
text. A curve takes a few hundred bytes and a chart about a millisecond, so a running study can
rewrite its page often.

Contours in a panel run halfway between the pixels of a mask and their neighbours outside.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray
from skimage.measure import find_contours

from palpate.service.number_formatting import MINUS
from palpate.storage.values import BoolArray

# Width of a letter relative to the font size, slightly overestimated.
LETTER = 0.56
TEXT_PX = 12.5
# An axis is logarithmic if the ratio of its limits is at least this.
SPAN_OF_LOG = 100.0
SMALL_PX = 11.5

Mark = Literal["dot", "ring", "diamond", "stroke", "cross", "triangle", "line", "dashed", "box"]


@dataclass
class Svg:
    """A drawing in pixels, with y pointing down.

    Parameters
    ----------
    width, height : float
    """

    width: float
    height: float
    parts: list[str] = field(default_factory=list)

    def add(self, tag: str, text: str | None = None, /, **attributes: object) -> None:
        """Add an element; ``class_`` and ``stroke_width`` become class and stroke-width."""
        head = "".join(
            f' {name.strip("_").replace("_", "-")}="{_written(value)}"'
            for name, value in attributes.items()
        )
        body = "/>" if text is None else f">{escape(text)}</{tag}>"
        self.parts.append(f"<{tag}{head}{body}")

    def text(self, x: float, y: float, text: str, **attributes: object) -> None:
        """Add a line of text with its baseline starting at a point."""
        self.add("text", text, x=x, y=y, **attributes)

    def titled(self, title: str, tag: str, **attributes: object) -> None:
        """Add an element with a tooltip."""
        self.parts.append("<g>")
        self.add("title", title)
        self.add(tag, **attributes)
        self.parts.append("</g>")

    def polyline(self, points: Iterable[tuple[float, float]], class_: str) -> None:
        """Add a curve; points that are not finite interrupt it."""
        commands, pen = [], "M"
        for x, y in points:
            if not (math.isfinite(x) and math.isfinite(y)):
                pen = "M"
                continue
            commands.append(f"{pen}{_written(x)} {_written(y)}")
            pen = "L"
        if commands:
            self.add("path", d="".join(commands), class_=class_)

    def dots(
        self,
        points: Sequence[tuple[float, float]],
        class_: str,
        numbers: Sequence[int] = (),
        **attributes: object,
    ) -> None:
        """Add many dots as one element; `numbers` are the numbers of their evaluations.

        A dot is a stroke of zero length with round ends. The page's script reads the positions
        from the same text.
        """
        if not points:
            return
        places = "".join(f"M{_written(x)} {_written(y)}h0" for x, y in points)
        told: dict[str, object] = {"data_i": " ".join(map(str, numbers))} if numbers else {}
        self.add("path", d=places, class_=f"dots {class_}", **told, **attributes)

    def mark(self, kind: Mark, x: float, y: float, class_: str, size: float = 5.0) -> None:
        """Add a mark of a legend or a chart, centred at a point."""
        s = size
        if kind == "dot" or kind == "ring":
            self.add("circle", cx=x, cy=y, r=s, class_=class_)
        elif kind == "box":
            self.add("rect", x=x - 6, y=y - 5, width=12, height=10, rx=2, class_=class_)
        else:
            shape = {
                "diamond": f"M{x - s:.1f} {y:.1f}l{s:.1f} {-s:.1f} {s:.1f} {s:.1f} {-s:.1f} "
                f"{s:.1f}z",
                "stroke": f"M{x:.1f} {y - s:.1f}v{2 * s:.1f}",
                "cross": f"M{x - s:.1f} {y - s:.1f}l{2 * s:.1f} {2 * s:.1f}m0 {-2 * s:.1f}"
                f"l{-2 * s:.1f} {2 * s:.1f}",
                "triangle": f"M{x - s:.1f} {y - s:.1f}h{2 * s:.1f}l{-s:.1f} {1.7 * s:.1f}z",
                "line": f"M{x - 9:.1f} {y:.1f}h18",
                "dashed": f"M{x - 9:.1f} {y:.1f}h18",
            }[kind]
            self.add("path", d=shape, class_=class_)

    def markup(self, label: str, classes: str = "", **data: str) -> Markup:
        """Return the drawing as an element of a page.

        Parameters
        ----------
        label : str
            Alternative text.
        classes : str
            Added to ``chart``.
        data : str
            Written as ``data-name``.
        """
        told = Markup("").join(
            Markup(' data-{}="{}"').format(k.replace("_", "-"), v) for k, v in data.items()
        )
        head = Markup(
            '<svg class="chart {}" viewBox="0 0 {} {}" style="max-width:{}px" role="img" '
            'aria-label="{}"{}>'
        ).format(classes, *map(_written, (self.width, self.height, self.width)), label, told)
        return head + Markup("".join(self.parts)) + Markup("</svg>")


@dataclass(frozen=True)
class Scale:
    """A linear axis that maps `lower` to `upper` onto pixels `start` to `end`."""

    lower: float
    upper: float
    start: float
    end: float

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        share = (value - self.lower) / (self.upper - self.lower)
        return self.start + share * (self.end - self.start)

    def ticks(self, most: int) -> list[float]:
        """Return at most about `most` round values inside the axis, in steps of 1, 2 or 5."""
        span = self.upper - self.lower
        power = 10.0 ** math.floor(math.log10(span / max(1, most)))
        step = next(s * power for s in (1, 2, 5, 10, 20) if span / (s * power) <= most + 1e-6)
        first = math.ceil(self.lower / step - 1e-9)
        last = math.floor(self.upper / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


@dataclass(frozen=True)
class LogScale(Scale):
    """A logarithmic axis; all values are positive."""

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        share = math.log(value / self.lower) / math.log(self.upper / self.lower)
        return self.start + share * (self.end - self.start)

    def ticks(self, most: int) -> list[float]:
        """Return 1, 2 and 5 times powers of ten, or only the powers if there are many."""
        first = math.floor(math.log10(self.lower))
        last = math.ceil(math.log10(self.upper))
        powers = range(first, last + 1)
        finest = [m * 10.0**k for k in powers for m in (1, 2, 5)]
        every = -(-len(powers) // max(1, most))
        for ticks in (finest, [10.0**k for k in powers], [10.0**k for k in powers[::every]]):
            inside = [
                v for v in ticks if self.lower <= v * (1 + 1e-9) and v <= self.upper * (1 + 1e-9)
            ]
            if len(inside) <= most:
                break
        return inside


def spans_decades(lower: float, upper: float) -> bool:
    """Check whether values between these limits belong on a logarithmic axis."""
    return lower > 0 and upper >= SPAN_OF_LOG * lower


def scale_between(lower: float, upper: float, start: float, end: float) -> Scale:
    """Return a logarithmic axis if positive limits are decades apart, else a linear one."""
    return (LogScale if spans_decades(lower, upper) else Scale)(lower, upper, start, end)


def tick_text(value: float) -> str:
    """Return a tick label without rounding noise, with a typographic minus."""
    return f"{value + 0.0:.10g}".replace("-", MINUS)


def text_width(text: str, size: float = TEXT_PX) -> float:
    """Return the approximate width of a text in pixels."""
    return LETTER * size * len(text)


def horizontal_axis(
    svg: Svg, scale: Scale, y: float, label: str, most: int = 8, top: float | None = None
) -> None:
    """Draw ticks and a label below a chart, and grid lines up to `top`."""
    for value in scale.ticks(most):
        x = scale.at(value)
        if top is not None:
            svg.add("path", d=f"M{x:.1f} {top:.1f}V{y:.1f}", class_="grid")
        svg.add("path", d=f"M{x:.1f} {y:.1f}v4", class_="axis")
        svg.text(x, y + 16, tick_text(value), text_anchor="middle", class_="tick")
    svg.add("path", d=f"M{scale.start:.1f} {y:.1f}H{scale.end:.1f}", class_="axis")
    if label:
        svg.text((scale.start + scale.end) / 2, y + 34, label, text_anchor="middle")


def vertical_axis(
    svg: Svg, scale: Scale, x: float, label: str, right: float, most: int = 6
) -> None:
    """Draw ticks and a label left of a chart, and grid lines to `right`."""
    for value in scale.ticks(most):
        y = scale.at(value)
        svg.add("path", d=f"M{x:.1f} {y:.1f}H{right:.1f}", class_="grid")
        svg.text(x - 6, y + 4, tick_text(value), text_anchor="end", class_="tick")
    middle = (scale.start + scale.end) / 2
    svg.text(
        14, middle, label, text_anchor="middle", transform=f"rotate(-90 14 {_written(middle)})"
    )


def legend(
    svg: Svg, items: Sequence[tuple[Mark, str, str]], x: float, y: float, right: float
) -> float:
    """Draw (mark, class, text) in rows that end before `right`; return their height."""
    left, top = x, y
    for mark, class_, text in items:
        width = 26 + text_width(text, SMALL_PX)
        if left > x and left + width > right:
            left, y = x, y + 19
        svg.mark(mark, left + 9, y, class_, 4.5)
        svg.text(left + 22, y + 4, text, class_="tick")
        left += width + 14
    return y - top + 19


def _written(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1f}".removesuffix(".0")
    return str(escape(value))


Contour = NDArray[np.int64]


def contours(inside: BoolArray) -> list[Contour]:
    """Return the lines halfway between pixels inside and their neighbours outside.

    Lines end at the edge of the mask; the last point of a closed one equals the first.

    Parameters
    ----------
    inside : ndarray of bool, shape (rows, columns)
        Row 0 at the bottom.

    Returns
    -------
    list of ndarray of int, shape (n, 2)
        Vertices (across, up) in half pixels from the centre of ``inside[0, 0]``.
    """
    if min(inside.shape) < 2:
        return []
    found = find_contours(inside.astype(np.float64), 0.5)
    return [_bends(np.rint(2 * line[:, ::-1]).astype(np.int64)) for line in found]


def _bends(line: Contour) -> Contour:
    steps = np.diff(line, axis=0)
    bend = (steps[1:] != steps[:-1]).any(axis=1)
    return line[np.concatenate([[True], bend, [True]])]


def path_of(lines: list[Contour]) -> str:
    """Return lines as the data of an SVG path, in relative steps."""
    commands = []
    for line in lines:
        (x, y), steps = line[0].tolist(), np.diff(line, axis=0).ravel().tolist()
        commands.append(f"M{x} {y}l" + " ".join(map(str, steps)))
    return "".join(commands)


Frame = tuple[float, float, float, float]
# Margins of a panel: ticks and a label on the left and below, a title above.
LEFT_PX, BELOW_PX, ABOVE_PX = 52.0, 42.0, 18.0
TICK_PX = 4.0
LINE_PX = 0.6
TICKS = 5


@dataclass(frozen=True)
class Panel:
    """A frame in space and its place in a drawing.

    Parameters
    ----------
    frame_mm : tuple of float
        Left, right, bottom and top.
    x, y : float
        Upper left corner in pixels.
    per_mm : float
        Pixels per mm.
    """

    frame_mm: Frame
    x: float
    y: float
    per_mm: float

    @property
    def across(self) -> Scale:
        """Return the horizontal axis."""
        left, right, _, _ = self.frame_mm
        return Scale(left, right, self.x, self.x + self.per_mm * (right - left))

    @property
    def up(self) -> Scale:
        """Return the vertical axis."""
        _, _, bottom, top = self.frame_mm
        return Scale(bottom, top, self.y + self.per_mm * (top - bottom), self.y)

    def image(self, svg: Svg, address: str, extent_mm: Frame, **attributes: object) -> None:
        """Draw an image with its edges at `extent_mm`."""
        left, right, bottom, top = extent_mm
        x, y = self.across.at(left), self.up.at(top)
        svg.add(
            "image",
            href=address,
            preserveAspectRatio="none",
            x=f"{x:.2f}",
            y=f"{y:.2f}",
            width=f"{self.per_mm * (right - left):.2f}",
            height=f"{self.per_mm * (top - bottom):.2f}",
            **attributes,
        )

    def lines(
        self,
        svg: Svg,
        lines: list[Contour],
        spacing_mm: tuple[float, float],
        origin_mm: tuple[float, float],
    ) -> None:
        """Draw lines between pixels of a section; the origin is the centre of its first pixel."""
        if not lines:
            return
        (dx, dy), (x, y) = spacing_mm, origin_mm
        # Points are in half pixels of the section; integer steps in tenths of a drawing pixel are
        # compact.
        tenths = 10 * self.per_mm * np.array([dx, dy]) / 2
        svg.add(
            "path",
            d=path_of([np.rint(line * tenths).astype(np.int64) for line in lines]),
            class_="interface",
            stroke_width=10 * LINE_PX,
            transform=f"translate({self.across.at(x):.2f} {self.up.at(y):.2f}) scale(.1 -.1)",
        )

    def axes(self, svg: Svg, across: str, up: str, below: Sequence[str] = ()) -> None:
        """Draw both axes with their labels; `below` are further lines below them."""
        right, upwards = self.across, self.up
        x, y = right.start, upwards.start
        for value in right.ticks(TICKS):
            pixel = right.at(value)
            svg.add("path", d=f"M{pixel:.1f} {y:.1f}v{TICK_PX:.1f}", class_="axis")
            svg.text(pixel, y + 15, tick_text(value), text_anchor="middle", class_="tick")
        for value in upwards.ticks(TICKS):
            pixel = upwards.at(value)
            svg.add("path", d=f"M{x:.1f} {pixel:.1f}h{-TICK_PX:.1f}", class_="axis")
            svg.text(x - 7, pixel + 4, tick_text(value), text_anchor="end", class_="tick")
        svg.add("path", d=f"M{x:.1f} {upwards.end:.1f}V{y:.1f}H{right.end:.1f}", class_="axis")
        middle = (right.start + right.end) / 2
        for number, line in enumerate((across, *below)):
            svg.text(middle, y + 31 + 16 * number, line, text_anchor="middle")
        pixel = (upwards.start + upwards.end) / 2
        turned = f"rotate(-90 {x - 38:.1f} {pixel:.1f})"
        svg.text(x - 38, pixel, up, text_anchor="middle", transform=turned)

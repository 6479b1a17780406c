"""Charts as inline SVG.

Colours are classes of the page's style sheet, so charts follow light and dark mode; text stays
text. A curve takes a few hundred bytes and a chart about a millisecond, so a running study can
rewrite its page often.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from markupsafe import Markup, escape

from palpate.service.formatting import MINUS

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

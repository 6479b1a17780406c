"""Panels that show a region of space to scale, with axes in mm."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.report.drawing.contours import Line, path_of
from palpate.service.report.drawing.svg import Scale, Svg, tick_text

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
        lines: list[Line],
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
            at = right.at(value)
            svg.add("path", d=f"M{at:.1f} {y:.1f}v{TICK_PX:.1f}", class_="axis")
            svg.text(at, y + 15, tick_text(value), text_anchor="middle", class_="tick")
        for value in upwards.ticks(TICKS):
            at = upwards.at(value)
            svg.add("path", d=f"M{x:.1f} {at:.1f}h{-TICK_PX:.1f}", class_="axis")
            svg.text(x - 7, at + 4, tick_text(value), text_anchor="end", class_="tick")
        svg.add("path", d=f"M{x:.1f} {upwards.end:.1f}V{y:.1f}H{right.end:.1f}", class_="axis")
        middle = (right.start + right.end) / 2
        for number, line in enumerate((across, *below)):
            svg.text(middle, y + 31 + 16 * number, line, text_anchor="middle")
        at = (upwards.start + upwards.end) / 2
        turned = f"rotate(-90 {x - 38:.1f} {at:.1f})"
        svg.text(x - 38, at, up, text_anchor="middle", transform=turned)

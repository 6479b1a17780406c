"""Drawings in a page, with alternative texts and captions."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from markupsafe import Markup

from palpate.service.report.drawing.svg import Svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = Sequence[str | float | None]
SCREEN_DPI = 96
# Widths in pixels of the two forms of a chart; the style sheet selects the one that fits.
WIDE_PX, NARROW_PX = 980.0, 400.0


@dataclass(frozen=True)
class Picture:
    """A drawing in the page.

    Parameters
    ----------
    svg : Markup
    alt : str
        Alternative text.
    width_px : int
    caption : str or Markup
    table : str or Markup
        Its numbers, for saving as CSV; see `table_of`.
    """

    svg: Markup
    alt: str
    width_px: int
    caption: str | Markup = ""
    table: str | Markup = ""


def picture(
    drawn: "Figure", alt: str, caption: str | Markup = "", *, on_paper: bool = False
) -> Picture:
    """Return a matplotlib figure as a picture; see `service.report.drawing.canvas.inline_svg`."""
    # Loads matplotlib, which most pages do not need.
    from palpate.service.report.drawing.canvas import inline_svg

    width = round(SCREEN_DPI * drawn.get_figwidth())
    return Picture(inline_svg(drawn, alt, width, on_paper=on_paper), alt, width, caption)


def chart(
    draw: Callable[[float], Svg],
    alt: str,
    caption: str | Markup = "",
    rows: Sequence[Row] = (),
    **data: str,
) -> Picture:
    """Draw a chart twice, for wide and narrow pages; `rows` are its numbers, header first."""
    both = draw(WIDE_PX).markup(alt, "wide", **data) + draw(NARROW_PX).markup(alt, "narrow", **data)
    return Picture(both, alt, round(WIDE_PX), caption, table_of(rows))


def small_chart(drawn: Svg, alt: str, caption: str | Markup = "", **data: str) -> Picture:
    """Return a chart that is drawn once, for wide and narrow pages."""
    return Picture(drawn.markup(alt, **data), alt, round(drawn.width), caption)


def table_of(rows: Sequence[Row]) -> Markup:
    """Return rows as an element for the page's script; empty if there are none."""
    if not rows:
        return Markup("")
    plain = [[None if _is_unknown(cell) else cell for cell in row] for row in rows]
    text = json.dumps(plain, ensure_ascii=False, allow_nan=False).replace("</", "<\\/")
    return (
        Markup('<script type="application/json" class="table">')
        + Markup(text)
        + Markup("</script>")
    )


def _is_unknown(cell: object) -> bool:
    return isinstance(cell, float) and not math.isfinite(cell)

"""Puts a figure into a page as an image, with the words that go with it."""

from dataclasses import dataclass

from markupsafe import Markup
from matplotlib.figure import Figure

from service.report.canvas import data_uri

SCREEN_DPI = 96


@dataclass(frozen=True)
class Picture:
    """An image in the page: its data, what it shows, its width, and what stands below it."""

    uri: str
    alt: str
    width_px: int
    caption: str | Markup = ""


def picture(drawn: Figure, alt: str, caption: str | Markup = "") -> Picture:
    """Draw a figure for good."""
    return Picture(data_uri(drawn), alt, round(SCREEN_DPI * drawn.get_figwidth()), caption)

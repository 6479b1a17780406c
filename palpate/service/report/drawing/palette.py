"""Colours that readers with colour vision deficiency can distinguish.

Charts use the colours of Okabe and Ito (2008) and greys. Tissues differ in
lightness as well as in hue, so that a page printed in grey can still be read.
"""

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import Tissue

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

TISSUES: dict[Tissue, str] = {
    Tissue.AIR: "#ffffff",
    Tissue.FAT: "#f4e7c3",
    Tissue.GLANDULAR: "#a8326e",
    Tissue.SKIN: "#6d5647",
    Tissue.MUSCLE: "#d2694a",
    Tissue.LIGAMENT: "#86b4c9",
}
UNKNOWN = "#000000"
# Surfaces in a viewer, lighter than the tissues of a slice.
INTERFACES = {"outline": "#e9d3b4", "glandular": "#c2628f"}


class Difference(IntEnum):
    """Classes of voxels in the comparison of target and best candidate."""

    OUTSIDE = 0
    BODY = 1
    BOTH = 2
    ONLY_TARGET = 3
    ONLY_BEST = 4


# Greys are translucent, to suit light and dark pages.
DIFFERENCES: dict[Difference, str] = {
    Difference.OUTSIDE: "#ffffff00",
    Difference.BODY: "#8a94a12e",
    Difference.BOTH: "#8a94a199",
    Difference.ONLY_TARGET: "#107ac0ff",
    Difference.ONLY_BEST: "#e69f00ff",
}


def lookup(colours: Mapping[int, str]) -> NDArray[np.uint8]:
    """Return a table of 256 colours by label; other labels are black, air is transparent.

    Returns
    -------
    ndarray of uint8, shape (256, 4)
        Red, green, blue and opacity.
    """
    table = np.tile(np.asarray(to_rgba(UNKNOWN)), (256, 1))
    for label, colour in colours.items():
        table[int(label)] = to_rgba(colour)
    table[0, 3] = 0.0
    return np.rint(255 * table).astype(np.uint8)


def to_rgba(colour: str) -> tuple[float, float, float, float]:
    """Return the components, 0 to 1, of a colour written #rrggbb or #rrggbbaa."""
    digits = colour.removeprefix("#").ljust(8, "f")
    r, g, b, a = (int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4, 6))
    return r, g, b, a

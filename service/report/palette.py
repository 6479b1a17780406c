"""Defines colours that stay apart for readers who see fewer of them.

Charts take the blue, orange and greys of Okabe and Ito (2008). Tissues differ in
lightness as well as in hue, so that a page printed in grey can still be read.
"""

from enum import IntEnum

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from numpy.typing import NDArray

from storage.values import Tissue

INK = "#1f2733"
SOFT_INK = "#5d6775"
RULE = "#d8dde4"
BLUE = "#0072b2"
ORANGE = "#e69f00"
VERMILION = "#c44e00"
GREY = "#8a94a1"

TISSUES: dict[Tissue, str] = {
    Tissue.AIR: "#ffffff",
    Tissue.FAT: "#f4e7c3",
    Tissue.GLANDULAR: "#a8326e",
    Tissue.SKIN: "#6d5647",
    Tissue.MUSCLE: "#d2694a",
    Tissue.LIGAMENT: "#86b4c9",
}
UNKNOWN = "#000000"


class Difference(IntEnum):
    """What a voxel of target and best candidate is."""

    OUTSIDE = 0
    BODY = 1
    BOTH = 2
    ONLY_TARGET = 3
    ONLY_BEST = 4


DIFFERENCES: dict[Difference, str] = {
    Difference.OUTSIDE: "#ffffff",
    Difference.BODY: "#eef0f3",
    Difference.BOTH: "#b9c0ca",
    Difference.ONLY_TARGET: BLUE,
    Difference.ONLY_BEST: ORANGE,
}

# From the first generation to the last.
AGES = LinearSegmentedColormap.from_list("ages", ["#b4c6d6", "#0072b2", "#0a2a43"])

# One colour for each stage of an evaluation, in the order in which they happen.
STAGES = ("#0072b2", "#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#8a94a1")


def lookup(colours: dict[Tissue, str] | dict[Difference, str]) -> NDArray[np.uint8]:
    """Return a table of 256 RGB colours by label; labels without a colour are black.

    Returns
    -------
    ndarray of uint8, shape (256, 3)
    """
    table = np.tile(np.asarray(to_rgb(UNKNOWN)), (256, 1))
    for label, colour in colours.items():
        table[int(label)] = to_rgb(colour)
    return np.rint(255 * table).astype(np.uint8)

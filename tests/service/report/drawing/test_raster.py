"""Sections as PNG, checked with an independent reader."""

import base64
import io

import numpy as np
from matplotlib import image

from palpate.service.report.drawing import colours
from palpate.service.report.drawing.raster import image_uri, png
from palpate.storage.values import Tissue


def test_every_pixel_has_the_colour_of_its_label_and_air_is_clear() -> None:
    labels = np.array([[0, 1, 2], [3, 0, 5]], np.uint8)  # row 0 at the bottom
    table = colours.colour_table({int(t): c for t, c in colours.TISSUE_PALETTE.items()})
    pixels = np.rint(255 * image.imread(io.BytesIO(png(labels, table)))).astype(int)
    assert pixels.shape == (2, 3, 4)
    assert pixels[::-1].tolist() == table[labels].tolist()
    assert pixels[1, 0, 3] == 0
    fat = colours.TISSUE_PALETTE[Tissue.FAT]
    assert pixels[1, 1].tolist() == [*bytes.fromhex(fat[1:]), 255]


def test_image_keeps_colours_and_transparency() -> None:
    """Two rows of three pixels, row 0 at the bottom."""
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4) * 10
    told = base64.b64decode(image_uri(pixels).removeprefix("data:image/png;base64,"))
    read = np.rint(255 * image.imread(io.BytesIO(told))).astype(int)
    assert read[::-1].tolist() == pixels.tolist()

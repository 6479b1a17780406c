"""A section as a PNG, read by another reader."""

import io

import numpy as np
from matplotlib import image

from service.report import palette
from service.report.raster import png
from storage.values import Tissue


def test_every_pixel_has_the_colour_of_its_label_and_air_is_clear() -> None:
    labels = np.array([[0, 1, 2], [3, 0, 5]], np.uint8)  # row 0 at the bottom
    table = palette.lookup({int(t): c for t, c in palette.TISSUES.items()})
    pixels = np.rint(255 * image.imread(io.BytesIO(png(labels, table)))).astype(int)
    assert pixels.shape == (2, 3, 4)
    assert pixels[::-1].tolist() == table[labels].tolist()
    assert pixels[1, 0, 3] == 0
    fat = palette.TISSUES[Tissue.FAT]
    assert pixels[1, 1].tolist() == [*bytes.fromhex(fat[1:]), 255]

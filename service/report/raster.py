"""Writes labels as a small PNG: one byte a pixel, a palette, clear where there is air."""

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray


def png(labels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> bytes:
    """Return an indexed image (W3C, Portable Network Graphics, colour type 3).

    Parameters
    ----------
    labels : ndarray of uint8, shape (rows, columns)
        Row 0 at the bottom.
    colours : ndarray of uint8, shape (256, 4)
        Red, green, blue and opacity by label.
    """
    rows, columns = labels.shape
    used = int(labels.max(initial=0)) + 1
    lines = np.zeros((rows, columns + 1), np.uint8)  # each line begins with its filter: none
    lines[:, 1:] = labels[::-1]
    head = struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)
    chunks = (
        (b"IHDR", head),
        (b"PLTE", colours[:used, :3].tobytes()),
        (b"tRNS", colours[:used, 3].tobytes()),
        (b"IDAT", zlib.compress(lines.tobytes(), 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def png_uri(labels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Return the image as an address, for a page that needs no other file."""
    return "data:image/png;base64," + base64.b64encode(png(labels, colours)).decode()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

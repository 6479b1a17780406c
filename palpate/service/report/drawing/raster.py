"""Images made of pixels: small PNG files in a page, and the triangle that is visible at each pixel.

Images are PNG (W3C, Portable Network Graphics) in data URIs, with a palette or with RGBA pixels.
For a surface in three dimensions, every row of pixels is intersected with the sides of its
triangles, and the nearest one is seen.
"""

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray

INDEXED, WITH_OPACITY = 3, 6


def png(labels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> bytes:
    """Return an image with one byte per pixel and a palette (colour type 3).

    Parameters
    ----------
    labels : ndarray of uint8, shape (rows, columns)
        Row 0 at the bottom.
    colours : ndarray of uint8, shape (256, 4)
        Red, green, blue and opacity by label.
    """
    used = int(labels.max(initial=0)) + 1
    palette = [(b"PLTE", colours[:used, :3].tobytes()), (b"tRNS", colours[:used, 3].tobytes())]
    return _png_file(labels[:, :, None], INDEXED, palette)


def png_uri(labels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Return an image with a palette as a data URI."""
    return _data_uri(png(labels, colours))


def image_uri(pixels: NDArray[np.uint8]) -> str:
    """Return an RGBA image as a data URI (colour type 6).

    Parameters
    ----------
    pixels : ndarray of uint8, shape (rows, columns, 4)
        Red, green, blue and opacity; row 0 at the bottom.
    """
    return _data_uri(_png_file(pixels, WITH_OPACITY, []))


def _png_file(pixels: NDArray[np.uint8], kind: int, palette: list[tuple[bytes, bytes]]) -> bytes:
    rows, columns, depth = pixels.shape
    lines = np.zeros((rows, 1 + columns * depth), np.uint8)  # each begins with its filter: none
    lines[:, 1:] = pixels[::-1].reshape(rows, -1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, kind, 0, 0, 0)),
        *palette,
        (b"IDAT", zlib.compress(lines.tobytes())),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(name, data) for name, data in chunks)


def _data_uri(image: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(image).decode()


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


NO_TRIANGLE = -1


def front_triangles(
    corners: FloatArray, nearness: FloatArray, rows: int, columns: int
) -> NDArray[np.int64]:
    """Return the index of the nearest triangle at the centre of each pixel.

    Every row of pixels is intersected with the sides of the triangles that it meets, so only pixels
    inside triangles are visited.

    Parameters
    ----------
    corners : ndarray, shape (m, 3, 2)
        Corners across and up, in pixels from the lower left corner of the picture.
    nearness : ndarray, shape (m,)
        At each pixel, the triangle with the largest value is visible.
    rows, columns : int
        Size of the picture.

    Returns
    -------
    ndarray of int, shape (rows, columns)
        Row 0 at the bottom; `NO_TRIANGLE` without a triangle.
    """
    order = np.argsort(nearness, kind="stable")
    x, y = corners[order].transpose(2, 0, 1)
    first, last = _middles(y.min(axis=1), y.max(axis=1), rows)
    triangle, row = _ranges(first, last)
    low, high = _cut(x[triangle], y[triangle], np.asarray(row + 0.5, np.float64))
    left, right = _middles(low, high, columns)
    line, column = _ranges(left, right)
    seen = np.full(rows * columns, NO_TRIANGLE)
    np.maximum.at(seen, row[line] * columns + column, triangle[line])
    return np.append(order, NO_TRIANGLE)[seen].reshape(rows, columns)


def _middles(
    low: FloatArray, high: FloatArray, size: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and last of `size` pixels with centres between two positions."""
    first, last = np.ceil(low - 0.5), np.floor(high - 0.5)
    return np.clip(first, 0, size).astype(np.int64), np.clip(last, -1, size - 1).astype(np.int64)


def _ranges(
    first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all integers of ranges `first` to `last`, and the range of each."""
    counts = np.maximum(last - first + 1, 0)
    which = np.repeat(np.arange(len(counts)), counts)
    ends = np.cumsum(counts)
    return which, np.arange(len(which)) + (first - ends + counts)[which]


def _cut(x: FloatArray, y: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the entry and exit points of lines along x at `at` in the triangles they meet."""
    low, high = np.full(len(at), np.inf), np.full(len(at), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        rise = y[:, b] - y[:, a]
        met = (at - y[:, a]) * (at - y[:, b]) <= 0
        share = (at - y[:, a]) / np.where(rise == 0, 1.0, rise)
        place = x[:, a] + share * (x[:, b] - x[:, a])
        met &= rise != 0
        low = np.where(met, np.minimum(low, place), low)
        high = np.where(met, np.maximum(high, place), high)
    return low, high

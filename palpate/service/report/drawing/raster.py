"""Small PNG images (W3C, Portable Network Graphics) for embedding in a page."""

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

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
    return _file(labels[:, :, None], INDEXED, palette)


def png_uri(labels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Return an image with a palette as a data URI."""
    return _address(png(labels, colours))


def image_uri(pixels: NDArray[np.uint8]) -> str:
    """Return an RGBA image as a data URI (colour type 6).

    Parameters
    ----------
    pixels : ndarray of uint8, shape (rows, columns, 4)
        Red, green, blue and opacity; row 0 at the bottom.
    """
    return _address(_file(pixels, WITH_OPACITY, []))


def _file(pixels: NDArray[np.uint8], kind: int, palette: list[tuple[bytes, bytes]]) -> bytes:
    rows, columns, depth = pixels.shape
    lines = np.zeros((rows, 1 + columns * depth), np.uint8)  # each begins with its filter: none
    lines[:, 1:] = pixels[::-1].reshape(rows, -1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, kind, 0, 0, 0)),
        *palette,
        (b"IDAT", zlib.compress(lines.tobytes())),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(name, data) for name, data in chunks)


def _address(image: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(image).decode()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

"""Contours around the pixels of a mask."""

import numpy as np
from numpy.typing import NDArray
from skimage.measure import find_contours

from palpate.storage.values import BoolArray

Line = NDArray[np.int64]


def contours(inside: BoolArray) -> list[Line]:
    """Return the lines halfway between pixels inside and their neighbours outside.

    Lines end at the edge of the mask; the last point of a closed one equals the first.

    Parameters
    ----------
    inside : ndarray of bool, shape (rows, columns)
        Row 0 at the bottom.

    Returns
    -------
    list of ndarray of int, shape (n, 2)
        Vertices (across, up) in half pixels from the centre of ``inside[0, 0]``.
    """
    if min(inside.shape) < 2:
        return []
    found = find_contours(inside.astype(np.float64), 0.5)
    return [_bends(np.rint(2 * line[:, ::-1]).astype(np.int64)) for line in found]


def _bends(line: Line) -> Line:
    steps = np.diff(line, axis=0)
    bend = (steps[1:] != steps[:-1]).any(axis=1)
    return line[np.concatenate([[True], bend, [True]])]


def path_of(lines: list[Line]) -> str:
    """Return lines as the data of an SVG path, in relative steps."""
    commands = []
    for line in lines:
        (x, y), steps = line[0].tolist(), np.diff(line, axis=0).ravel().tolist()
        commands.append(f"M{x} {y}l" + " ".join(map(str, steps)))
    return "".join(commands)

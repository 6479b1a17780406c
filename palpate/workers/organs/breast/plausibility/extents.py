"""Extents of a breast along an axis perpendicular to z."""

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, Tissue, Triple, Volume


def unit_axis(axis: Triple) -> Triple:
    """Return the unit vector of an axis perpendicular to z."""
    length = float(np.linalg.norm(axis))
    return axis[0] / length, axis[1] / length, 0.0


def extent_mm(labels: Volume, axis: Triple) -> tuple[float, float]:
    """Return the extent of the body, to its voxel faces, along an axis perpendicular to z."""
    along = np.asarray(axis[:2]) / np.linalg.norm(axis)
    y, x = _row_ends((labels.values != Tissue.AIR).any(axis=0))
    spacing = np.asarray(labels.spacing_mm[:2])
    places = np.asarray(labels.origin_mm[:2]) + spacing * np.column_stack([x, y])
    heights = places @ along
    half = float(np.abs(along) @ spacing) / 2
    return float(heights.min()) - half, float(heights.max()) + half


def _row_ends(there: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of the first and the last voxel of each nonempty row."""
    rows = np.flatnonzero(there.any(axis=1))
    first = there[rows].argmax(axis=1)
    last = there.shape[1] - 1 - there[rows, ::-1].argmax(axis=1)
    return np.concatenate([rows, rows]), np.concatenate([first, last])


def plate_frame(axis: Triple) -> FloatArray:
    """Return unit vectors perpendicular to the compression, along it and along z, as rows."""
    x, y, _ = unit_axis(axis)
    return np.array([[y, -x, 0.0], [x, y, 0.0], [0.0, 0.0, 1.0]])

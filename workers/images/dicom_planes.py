"""Where the slices of a DICOM image lie, and in which order they stack.

DICOM gives each slice its own position (PS3.3, C.7.6.2.1.1 and C.7.6.16.2.3);
that they make a regular stack has to be found out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.errors import InputError
from storage.values import FloatArray

GAP_TOLERANCE = 0.01
"""How far a slice may be from its place in the stack, in gaps."""


@dataclass(frozen=True, eq=False)
class Planes:
    """A regular stack.

    Parameters
    ----------
    slots : ndarray of int, shape (n,)
        Place of each given slice in the stack, 0 for the lowest along the normal.
    step_mm : ndarray, shape (3,)
        From the first row and column of one slice to those of the next.
    origin_mm : ndarray, shape (3,)
        Centre of the first pixel of slot 0.
    """

    slots: NDArray[np.intp]
    step_mm: FloatArray
    origin_mm: FloatArray


def stack(
    positions_mm: FloatArray, orientation: FloatArray, what: str, gap_mm: float | None = None
) -> Planes:
    """Sort slices along their normal.

    Parameters
    ----------
    positions_mm : ndarray, shape (n, 3)
        ImagePositionPatient of each slice. Slices may share one.
    orientation : ndarray, shape (6,)
        ImageOrientationPatient: direction of a row, then of a column.
    what : str
        How to name the image in messages.
    gap_mm : float, optional
        Distance of neighbours. Slots may then stay empty; otherwise the distance is
        found from the positions and every slot must be filled.

    Raises
    ------
    InputError
        If there are fewer than two places, or they are not evenly spaced on a line.
    """
    normal = np.cross(orientation[:3], orientation[3:])
    depth = positions_mm @ normal
    order = np.argsort(depth, kind="stable")
    gaps = np.diff(depth[order])
    apart = gaps[gaps > GAP_TOLERANCE * gaps.max()] if gaps.size and gaps.max() > 0 else gaps[:0]
    if not apart.size:
        raise InputError(
            f"{what} has slices at one position only; a volume needs two or more. "
            "Give the folder with the whole series."
        )
    gap = float(np.median(apart)) if gap_mm is None else gap_mm
    place = (depth - depth[order[0]]) / gap
    slots = np.rint(place).astype(np.intp)
    uneven = np.abs(place - slots) > GAP_TOLERANCE
    if gap_mm is None:
        uneven[order[1:]] |= np.diff(slots[order]) > 1
    if uneven.any():
        _refuse_gaps(gaps, gap, what)

    origin, last = positions_mm[order[0]], order[-1]
    step = (positions_mm[last] - origin) / slots[last]
    off = np.linalg.norm(positions_mm - origin - slots[:, None] * step, axis=1)
    if off.max() > GAP_TOLERANCE * gap:
        raise InputError(
            f"{what} has slices that do not lie on one line ({off.max():.3g} mm off). "
            "Resample it on a regular grid first."
        )
    return Planes(slots, step, origin)


def _refuse_gaps(gaps: FloatArray, gap: float, what: str) -> None:
    worst = int(np.argmax(np.abs(gaps - gap)))
    raise InputError(
        f"{what} has uneven gaps: slices {worst + 1} and {worst + 2} along the normal are "
        f"{gaps[worst]:.4g} mm apart, expected {gap:.4g} mm. A slice is missing, or "
        "two series are mixed; complete the series, or resample it on a regular grid."
    )


def plane_steps(orientation: FloatArray, pixel_spacing: Sequence[Any] | None) -> FloatArray:
    """Columns: the steps along column index and row index; NaN without PixelSpacing.

    PixelSpacing is (distance of rows, distance of columns).
    """
    rows, columns = (np.nan, np.nan) if pixel_spacing is None else map(float, pixel_spacing)
    return np.column_stack([orientation[:3] * columns, orientation[3:] * rows])


def check_orientation(values: Any, what: str) -> FloatArray:
    """ImageOrientationPatient as six numbers: two unit vectors at right angles.

    Raises
    ------
    InputError
        If they are missing or are not that.
    """
    orientation = np.array([] if values is None else values, dtype=float)
    if orientation.size == 6:
        row, column = orientation[:3], orientation[3:]
        frame = np.array([row @ row - 1, column @ column - 1, row @ column])
        if np.all(np.abs(frame) < 1e-3):
            return orientation
    raise InputError(
        f"{what} has the image orientation {orientation.tolist()}, expected the direction "
        "cosines of rows and columns. Export the series again with its geometry."
    )

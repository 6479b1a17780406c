"""Content of an image file, before it is converted to a `Volume`.

Every reader of a format returns a `Scan`: voxels by index axis and the position
of those axes in the patient's frame, LPS (x to the left, y to posterior, z to
superior). `workers.body.images.orient` makes a `Volume` of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0])
"""From NIfTI's frame (x right, y anterior) to LPS."""
SPACING_TOLERANCE = 1e-3
"""Relative difference of two spacings that is attributed to rounding."""
LABEL_TOLERANCE = 1e-3
"""Allowed distance of a label from a whole number, caused by scaling in floating point."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Voxels as stored in a file.

    Parameters
    ----------
    values : ndarray, shape (ni, nj, nk)
        Values by index axis, in any memory order.
    spacing_mm : ndarray, shape (3,)
        Distance between voxel centres along each index axis; NaN if it is missing in the file
        or not a valid distance.
    directions : ndarray, shape (3, 3)
        Columns are the unit vectors of the index axes in LPS.
    origin_mm : ndarray, shape (3,)
        Centre of ``values[0, 0, 0]`` in LPS.
    frame_uid : str
        DICOM frame of reference; empty if the file names none.
    place_known : bool
        True if the file gives origin and orientation.
    anatomical : bool
        True if the frame of the file is a patient's frame, so that left, posterior and
        superior are defined.
    names : mapping of int to str
        Names of labels, if the file has them.
    """

    values: NDArray[Any]
    spacing_mm: FloatArray
    directions: FloatArray
    origin_mm: FloatArray
    frame_uid: str = ""
    place_known: bool = True
    anatomical: bool = True
    names: Mapping[int, str] = field(default_factory=dict)

    @classmethod
    def without_frame(cls, values: NDArray[Any], spacing_mm: ArrayLike | None = None) -> "Scan":
        """Make a scan of unknown position, with axes x, y, z and the first voxel at (0, 0, 0)."""
        spacing = np.full(3, np.nan) if spacing_mm is None else np.array(spacing_mm, dtype=float)
        return cls(
            values,
            _distances(spacing),
            np.eye(3),
            np.zeros(3),
            place_known=False,
            anatomical=False,
        )

    @classmethod
    def with_steps(
        cls,
        values: NDArray[Any],
        steps_mm: ArrayLike,
        origin_mm: ArrayLike,
        frame: FloatArray | None = None,
    ) -> "Scan":
        """Make a scan from the step of each index axis (columns), given in `frame`.

        Parameters
        ----------
        steps_mm : array_like, shape (3, 3)
            Column a is the step from one voxel centre to the next along index axis a.
            If a column is zero or not finite, the axes are unknown: all three are then
            assumed along the declared frame, with unknown spacing and position.
        origin_mm : array_like, shape (3,)
            Centre of the first voxel; if not finite, (0, 0, 0) is used and the position is
            unknown.
        frame : ndarray, shape (3, 3), optional
            Matrix from the declared frame to LPS. Default: it is LPS.
        """
        to_lps = np.eye(3) if frame is None else frame
        steps = np.asarray(steps_mm, dtype=float)
        origin = np.asarray(origin_mm, dtype=float)
        known = bool(np.all(np.isfinite(origin)))
        if not known:
            origin = np.zeros(3)
        length = np.linalg.norm(steps, axis=0)
        if not (np.all(np.isfinite(length)) and np.all(length > 0)):
            unknown = np.full(3, np.nan)
            return cls(values, unknown, to_lps.copy(), to_lps @ origin, place_known=False)
        turned = to_lps @ (steps / length)
        return cls(values, length, turned, to_lps @ origin, place_known=known)


def _distances(spacing: FloatArray) -> FloatArray:
    return np.where(np.isfinite(spacing) & (spacing > 0), spacing, np.nan)


def three_axes(values: NDArray[Any], what: str) -> NDArray[Any]:
    """Drop axes of length one until three are left.

    Raises
    ------
    InputError
        If the image is 2-D, or has more than three axes longer than one.
    """
    extra = values.ndim - 3
    single = [axis for axis, size in enumerate(values.shape) if size == 1]
    if extra > 0 and len(single) == extra:
        return values.squeeze(tuple(single))
    if extra > 0 and len(single) < extra:
        raise InputError(
            f"{what} has {values.ndim} axes, shape {values.shape}; a volume has 3. "
            "Save one channel and one time point of it."
        )
    return values


def check_shape(values: NDArray[Any], what: str) -> None:
    """Raise InputError unless `values` has three axes of two voxels or more."""
    if values.ndim != 3 or min(values.shape) < 2:
        raise InputError(
            f"{what} is not a 3-D image: its shape is {values.shape}, but three axes of at least "
            "2 voxels are needed. Give the whole stack (a multi-page file, or the "
            "folder with its slices)."
        )


def whole_numbers(values: NDArray[Any], what: str) -> NDArray[Any]:
    """Return labels as native integers.

    Floats are rounded if all are within `LABEL_TOLERANCE` of a whole number.

    Raises
    ------
    InputError
        If a voxel is not a whole number, or has several values.
    """
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind in "iu":
        return values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind != "f":
        raise InputError(
            f"{what} has voxels of type {values.dtype}, expected one whole number each (labels). "
            "Save the label map itself, not its colours."
        )
    low, high = np.inf, -np.inf
    for part in values:
        _refuse_fractions(part, what)
        low, high = min(low, float(part.min())), max(high, float(part.max()))
    kind = _smallest_integer(np.rint(low), np.rint(high), what)
    return np.rint(values).astype(kind)


def _refuse_fractions(part: NDArray[Any], what: str) -> None:
    """Raise InputError if a value is not finite, or not a whole number."""
    finite = np.isfinite(part)
    if finite.all():
        odd = part[np.abs(part - np.rint(part)) > LABEL_TOLERANCE]
        if not odd.size:
            return
        example = str(odd[0])
    else:
        example = "NaN" if np.isnan(part[~finite]).any() else "infinity"
    advice = (
        "Write 0 where there is no body."
        if example == "NaN"
        else "Segment the image first; resample label maps with nearest neighbour."
    )
    raise InputError(
        f"{what} is not a label map: it contains {example}, but labels must be whole numbers. "
        f"{advice}"
    )


def _smallest_integer(low: float, high: float, what: str) -> type[np.integer[Any]]:
    for kind in (np.uint8, np.uint16, np.int16, np.int32, np.int64):
        limits = np.iinfo(kind)
        if limits.min <= low and high <= limits.max and abs(high) < 2**53:
            return kind
    raise InputError(f"{what} is not a label map: its values run from {low:g} to {high:g}.")

"""Positions and order of the slices of a DICOM image.

DICOM gives each slice its own position (PS3.3, C.7.6.2.1.1 and C.7.6.16.2.3);
whether they form a regular stack has to be checked.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.scan import Scan

STATED_TOLERANCE = 0.01
"""Allowed relative difference between the distance of neighbouring slices and its tag."""
MOST_SLOTS = 100_000
"""Largest number of slice positions between two neighbours."""
GAP_TOLERANCE = 0.05
"""Allowed deviation of a slice from its position in the stack, in gaps; positions are rounded."""


@dataclass(frozen=True, eq=False)
class Planes:
    """A regular stack of slices.

    Parameters
    ----------
    slots : ndarray of int, shape (n,)
        Position of each slice in the stack, 0 for the lowest along the normal.
    step_mm : ndarray, shape (3,)
        Step from the first row and column of one slice to those of the next.
    origin_mm : ndarray, shape (3,)
        Centre of the first pixel of slot 0.
    """

    slots: NDArray[np.intp]
    step_mm: FloatArray
    origin_mm: FloatArray


def stack(
    positions_mm: FloatArray,
    orientation: FloatArray,
    what: str,
    *,
    may_skip: bool = False,
) -> Planes:
    """Sort slices along their normal, with distances computed from their positions alone.

    Parameters
    ----------
    positions_mm : ndarray, shape (n, 3)
        ImagePositionPatient of each slice. Slices may share one.
    orientation : ndarray, shape (6,)
        ImageOrientationPatient: direction of a row, then of a column.
    what : str
        Name of the image in messages.
    may_skip : bool, optional
        Allow empty slots (segmentations omit empty slices).

    Raises
    ------
    InputError
        If there are fewer than two positions, or they are not evenly spaced on a line.
    """
    normal = np.cross(orientation[:3], orientation[3:])
    depth = positions_mm @ normal
    order = np.argsort(depth, kind="stable")
    gaps = np.diff(depth[order])
    apart = gaps[gaps > max(GAP_TOLERANCE * gaps.max(initial=0.0), 1e-6)]
    if not apart.size:
        raise InputError(
            f"{what} has slices at one position only; a volume needs two or more. "
            "Give the folder with the whole series."
        )
    gap_mm = float(apart.min() if may_skip else np.median(apart))
    if not np.isfinite(gaps).all() or gaps.max() > MOST_SLOTS * gap_mm:
        raise InputError(
            f"{what} has slices {gaps.max():.4g} mm apart and others {gap_mm:.4g} mm apart, so "
            "it is not a stack of slices. Export it again."
        )
    jumps = np.rint(gaps / gap_mm).astype(np.intp)
    slots = np.zeros(depth.size, dtype=np.intp)
    slots[order[1:]] = np.cumsum(jumps)
    count = max(int(slots[order[-1]]), 1)
    even = (depth[order[-1]] - depth[order[0]]) / count
    shift = np.abs(depth - depth[order[0]] - slots * even)
    odd = abs(even - gap_mm) > GAP_TOLERANCE * gap_mm
    if odd or shift.max() > GAP_TOLERANCE * even or (jumps.max() > 1 and not may_skip):
        _refuse_gaps(gaps, gap_mm, what)

    origin = positions_mm[order[0]]
    step = (positions_mm[order[-1]] - origin) / count
    off = np.linalg.norm(positions_mm - origin - slots[:, None] * step, axis=1)
    if off.max() > GAP_TOLERANCE * even:
        raise InputError(
            f"{what} has slices that are not on one line ({off.max():.3g} mm off). "
            "Resample it on a regular grid first."
        )
    return Planes(slots, step, origin)


def _refuse_gaps(gaps: FloatArray, gap_mm: float, what: str) -> None:
    worst = int(np.argmax(np.abs(gaps - gap_mm)))
    raise InputError(
        f"{what} has uneven gaps: slices {worst + 1} and {worst + 2} along the normal are "
        f"{gaps[worst]:.4g} mm apart, expected {gap_mm:.4g} mm. A slice is missing, or "
        "two series are mixed; complete the series, or resample it on a regular grid."
    )


def check_stated_gap(planes: Planes, tags: Any, what: str) -> None:
    """Raise InputError if a tag contradicts the distance between slice positions.

    SpacingBetweenSlices gives that distance. Without it, SliceThickness must equal the distance;
    with it, slices may overlap or leave gaps.

    Parameters
    ----------
    planes : Planes
    tags : pydicom.Dataset
        Data set of PixelMeasures, or of a slice.
    what : str
        Name of the image in messages.
    """
    gap = float(np.linalg.norm(planes.step_mm))
    for name in ("SpacingBetweenSlices", "SliceThickness"):
        stated = abs(float(tags.get(name) or 0))  # some scanners write a negative one
        if not stated:
            continue
        if abs(gap - stated) > STATED_TOLERANCE * stated:
            raise InputError(
                f"{what} is inconsistent: its slices are {gap:.4g} mm apart according to their "
                f"positions, expected {stated:.4g} mm according to its {name}. Export it again, or "
                "correct the one that is wrong."
            )
        return


def plane_scan(
    values: NDArray[Any], planes: Planes, orientation: FloatArray, pixel_spacing: Any
) -> Scan:
    """Return the scan of a stack.

    Parameters
    ----------
    values : ndarray, shape (slots, rows, columns)
    pixel_spacing : sequence of two numbers, or None
        DICOM's PixelSpacing: distance between rows, then between columns, in mm.
    """
    rows, columns = (np.nan, np.nan) if pixel_spacing is None else map(float, pixel_spacing)
    gap = float(np.linalg.norm(planes.step_mm))
    spacing = np.array([columns, rows, gap])
    spacing[~(np.isfinite(spacing) & (spacing > 0))] = np.nan
    directions = np.column_stack([orientation[:3], orientation[3:], planes.step_mm / gap])
    return Scan(values.transpose(), spacing, directions, planes.origin_mm)


def check_orientation(values: Any, what: str) -> FloatArray:
    """Return ImageOrientationPatient as six numbers: two unit vectors at right angles.

    Raises
    ------
    InputError
        If they are missing or invalid.
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

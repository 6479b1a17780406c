"""Sections through volumes, comparison of two sections, and the plates around a body in a section.

A section has rows from bottom to top and columns from left to right, both in mm. Its plane is
the layer of voxels nearest to the requested point; outside a volume's box there is air. Plates are
two parallel planes that touch the body, drawn as lines.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.service.report.drawing.colours import Difference
from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple, Volume

AXES = "xyz"
Labels = NDArray[np.uint8]


@dataclass(frozen=True)
class View:
    """A viewing direction.

    Parameters
    ----------
    name : str
        Anatomical name of the plane.
    normal, across, up : int
        Axes of space (0 x, 1 y, 2 z): normal to the plane, to the right and upwards.
    """

    name: str
    normal: int
    across: int
    up: int


# The plates press along y, so y points up wherever it is visible.
VIEWS = (
    View("coronal", normal=2, across=0, up=1),
    View("transverse", normal=0, across=2, up=1),
    View("sagittal", normal=1, across=0, up=2),
)


@dataclass(frozen=True, eq=False)
class Section:
    """Labels in a plane.

    Parameters
    ----------
    values : ndarray of uint8, shape (rows, columns)
        Row 0 at the bottom.
    spacing_mm : tuple of float
        Distance between voxel centres, across and up.
    origin_mm : tuple of float
        Centre of ``values[0, 0]``, across and up.
    """

    values: Labels
    spacing_mm: tuple[float, float]
    origin_mm: tuple[float, float]

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Return the left, right, bottom and top edge of the voxels."""
        rows, columns = self.values.shape
        (dx, dy), (x, y) = self.spacing_mm, self.origin_mm
        return x - dx / 2, x + (columns - 0.5) * dx, y - dy / 2, y + (rows - 0.5) * dy


def section(volume: Volume, view: View, at_mm: float) -> Section:
    """Return the plane of `volume` nearest to `at_mm` along the normal of `view`."""
    nearest = round((at_mm - volume.origin_mm[view.normal]) / volume.spacing_mm[view.normal])
    array_axis = 2 - view.normal  # arrays are indexed [z, y, x]
    values = np.asarray(volume.values)
    if 0 <= nearest < values.shape[array_axis]:
        plane = np.take(values, nearest, axis=array_axis)
    else:
        plane = np.zeros(np.delete(values.shape, array_axis), np.uint8)
    if view.up < view.across:  # the greater of the two other axes comes first
        plane = plane.T
    return Section(
        np.ascontiguousarray(plane, dtype=np.uint8),
        (volume.spacing_mm[view.across], volume.spacing_mm[view.up]),
        (volume.origin_mm[view.across], volume.origin_mm[view.up]),
    )


def middle_mm(volume: Volume, tissues: Iterable[int]) -> Triple:
    """Return the centroid of tissues as (x, y, z), or of the whole body if it has none of them.

    Raises
    ------
    InputError
        If the volume contains only air.
    """
    mask = np.isin(volume.values, [int(tissue) for tissue in tissues])
    if not mask.any():
        mask = np.asarray(volume.values) != Tissue.AIR
    if not mask.any():
        raise InputError("The volume contains only air, so it has no middle.")
    along = []
    for axis in range(3):
        counts = mask.sum(axis=tuple(a for a in range(3) if a != 2 - axis), dtype=np.float64)
        index = float(counts @ np.arange(len(counts)) / counts.sum())
        along.append(volume.origin_mm[axis] + index * volume.spacing_mm[axis])
    x, y, z = along
    return x, y, z


def difference(target: Section, best: Section, tissues: Iterable[int]) -> Section:
    """Mark tissues that are in the target, in the best candidate, or in both.

    Parameters
    ----------
    target, best : Section
        Sections on one lattice; their boxes may differ.
    tissues : iterable of int
        Compared tissues.

    Returns
    -------
    Section
        Values of `Difference`, on a box around both.
    """
    (first, second), origin = _on_one_box((target, best))
    labels = [int(tissue) for tissue in tissues]
    in_target, in_best = np.isin(first, labels), np.isin(second, labels)
    values = np.where((first != Tissue.AIR) | (second != Tissue.AIR), Difference.BODY, 0)
    values[in_target & in_best] = Difference.BOTH
    values[in_target & ~in_best] = Difference.ONLY_TARGET
    values[in_best & ~in_target] = Difference.ONLY_BEST
    return Section(values.astype(np.uint8), target.spacing_mm, origin)


def frame_mm(sections: Sequence[Section]) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a frame around all bodies, with a small margin."""
    boxes = np.array([_body_mm(s) for s in sections])
    left, bottom = boxes[:, [0, 2]].min(axis=0)
    right, top = boxes[:, [1, 3]].max(axis=0)
    margin = 0.04 * max(right - left, top - bottom)
    return left - margin, right + margin, bottom - margin, top + margin


def clipped(shown: Section, frame: tuple[float, float, float, float]) -> Section:
    """Return the voxels of a section with centres inside a frame; at least one."""
    left, right, bottom, top = frame
    (dx, dy), (x, y) = shown.spacing_mm, shown.origin_mm
    rows, columns = shown.values.shape
    c0, c1 = (min(max(math.ceil((v - x) / dx), 0), columns - 1) for v in (left, right))
    r0, r1 = (min(max(math.ceil((v - y) / dy), 0), rows - 1) for v in (bottom, top))
    inside = shown.values[r0 : max(r1, r0 + 1), c0 : max(c1, c0 + 1)]
    return Section(inside, shown.spacing_mm, (x + c0 * dx, y + r0 * dy))


def _body_mm(shown: Section) -> tuple[float, float, float, float]:
    solid = shown.values != 0
    if not solid.any():
        return shown.extent_mm
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    (dx, dy), (x, y) = shown.spacing_mm, shown.origin_mm
    return (
        x + (columns[0] - 0.5) * dx,
        x + (columns[-1] + 0.5) * dx,
        y + (rows[0] - 0.5) * dy,
        y + (rows[-1] + 0.5) * dy,
    )


def _on_one_box(sections: Sequence[Section]) -> tuple[list[Labels], tuple[float, float]]:
    """Return arrays of equal shape around all sections, and the centre of their first voxel."""
    dx, dy = sections[0].spacing_mm
    x0 = min(s.origin_mm[0] for s in sections)
    y0 = min(s.origin_mm[1] for s in sections)
    starts = [
        (round((s.origin_mm[1] - y0) / dy), round((s.origin_mm[0] - x0) / dx)) for s in sections
    ]
    ends = [np.add(start, s.values.shape) for start, s in zip(starts, sections, strict=True)]
    rows, columns = np.max(ends, axis=0)
    boxed = []
    for (row, column), s in zip(starts, sections, strict=True):
        array = np.zeros((rows, columns), np.uint8)
        array[row : row + s.values.shape[0], column : column + s.values.shape[1]] = s.values
        boxed.append(array)
    return boxed, (x0, y0)


PlateLine = tuple[tuple[float, float], tuple[float, float]]
FrameMm = tuple[float, float, float, float]
# Plates at less than about 3 degrees to a section are not drawn.
LEAST_SINE = 0.05


@dataclass(frozen=True)
class Plates:
    """Two parallel planes that touch a body.

    Parameters
    ----------
    axis : tuple of float
        Unit vector from the lower to the upper plate.
    heights_mm : tuple of float
        Heights of the lower and the upper plate along the axis.
    """

    axis: Triple
    heights_mm: tuple[float, float]

    def lines(
        self, view: View, at_mm: float, frame_mm: FrameMm, outwards_mm: float = 0.0
    ) -> list[PlateLine]:
        """Return the intersections of the plates with a section, from edge to edge of a frame.

        Parameters
        ----------
        view : View
        at_mm : float
            Place of the section along the normal of the view.
        frame_mm : tuple of float
            Left, right, bottom and top.
        outwards_mm : float
            Distance of the lines from the body, so as not to hide its skin.
        """
        a, b = self.axis[view.across], self.axis[view.up]
        if np.hypot(a, b) < LEAST_SINE:
            return []
        left, right, bottom, top = frame_mm
        plate_lines: list[PlateLine] = []
        low, high = self.heights_mm
        for height in (low - outwards_mm, high + outwards_mm):
            c = height - self.axis[view.normal] * at_mm
            if abs(b) >= abs(a):
                plate_lines.append(((left, (c - a * left) / b), (right, (c - a * right) / b)))
            else:
                plate_lines.append((((c - b * bottom) / a, bottom), ((c - b * top) / a, top)))
        return plate_lines


def plates_touching(body: Volume, axis: Triple) -> Plates:
    """Return the planes at both ends of a labelled body along an axis."""
    along = np.asarray(axis) / np.linalg.norm(axis)
    solid = body.values != 0
    heights = np.zeros(())
    for k, n in enumerate(body.shape_xyz):
        shape = [1, 1, 1]
        shape[2 - k] = n
        places = body.origin_mm[k] + np.arange(n) * body.spacing_mm[k]
        heights = heights + along[k] * places.reshape(shape)
    there = heights[solid] if solid.any() else heights
    half = 0.5 * float(np.abs(along) @ np.asarray(body.spacing_mm))
    x, y, z = along.tolist()
    return Plates((x, y, z), (float(there.min()) - half, float(there.max()) + half))

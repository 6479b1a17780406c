"""Positions of the focal spot, the body and the pixels of the detector."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume

CC_AXIS: Triple = (0.0, 1.0, 0.0)


def mlo_axis(oblique_deg: float = 45.0) -> Triple:
    """Return the direction from the lower to the upper plate in a mediolateral oblique view."""
    angle = np.radians(oblique_deg)
    return -float(np.sin(angle)), float(np.cos(angle)), 0.0


@dataclass(frozen=True)
class Unit:
    """A mammography unit.

    Parameters
    ----------
    source_mm : float
        Distance from the focal spot to the plane of the detector.
    gap_mm : float
        Distance from the detector to the plate under the body.
    pixel_mm : float
        Edge length of a pixel.

    Raises
    ------
    InputError
        If a length is not positive, or the plate is beyond the focal spot.
    """

    source_mm: float = 650.0
    gap_mm: float = 20.0
    pixel_mm: float = 0.2

    def __post_init__(self) -> None:
        if not (0 <= self.gap_mm < self.source_mm and self.pixel_mm > 0):
            raise InputError(
                "A mammography unit needs pixels > 0 mm and 0 <= gap < source distance, got "
                f"pixels of {self.pixel_mm:g} mm, a gap of {self.gap_mm:g} mm and a focal spot at "
                f"{self.source_mm:g} mm."
            )


@dataclass(frozen=True, eq=False)
class Geometry:
    """Rays from a point to the centres of pixels.

    Parameters
    ----------
    source_mm : ndarray, shape (3,)
        The focal spot.
    first_mm : ndarray, shape (3,)
        Centre of the pixel [0, 0].
    down_mm, right_mm : ndarray, shape (3,)
        Steps from a pixel to the next row and to the next column.
    rows, columns : int
    """

    source_mm: FloatArray
    first_mm: FloatArray
    down_mm: FloatArray
    right_mm: FloatArray
    rows: int
    columns: int

    @property
    def pixels_mm(self) -> FloatArray:
        """Centres of all pixels, shape (rows, columns, 3)."""
        row, column = np.mgrid[: self.rows, : self.columns]
        return np.asarray(
            self.first_mm + row[..., None] * self.down_mm + column[..., None] * self.right_mm
        )


def geometry_of(
    body: Volume, axis: Triple = CC_AXIS, unit: Unit = Unit(), support_mm: float | None = None
) -> Geometry:
    """Place a compressed body on the detector.

    The focal spot is above the chest-wall edge, at the z of the lowest voxel faces, and above the
    middle of the body along the wall; no pixel is behind the wall. Rows run along the wall, columns
    from the wall to the nipple.

    Parameters
    ----------
    body : Volume
        Labels; 0 is air.
    axis : tuple of float
        Direction from the lower to the upper plate, perpendicular to z.
    unit : Unit
    support_mm : float, optional
        Position of the lower plate's upper face along the axis; by default, the start of the body.

    Raises
    ------
    InputError
        If the volume is all air, the axis is not perpendicular to z, or the body reaches the
        focal spot.
    """
    up = np.asarray(axis, np.float64)
    if not (np.linalg.norm(up) > 0 and abs(up[2]) < 1e-9 * np.linalg.norm(up)):
        raise InputError(f"The axis of compression must be perpendicular to z, got {axis}.")
    up = up / np.linalg.norm(up)
    out = np.array([0.0, 0.0, 1.0])
    along = np.cross(up, out)
    corners = _corners(body)
    heights = corners @ up
    floor = float(heights.min()) if support_mm is None else support_mm
    plane = floor - unit.gap_mm
    if heights.max() >= plane + unit.source_mm:
        raise InputError(
            f"The body reaches {heights.max() - plane:.4g} mm above the detector, beyond the "
            f"focal spot at {unit.source_mm:g} mm. Check that the volume is the compressed body, "
            "in mm."
        )
    wall = float(corners[:, 2].min())
    middle = float((corners @ along).min() + (corners @ along).max()) / 2
    source = (plane + unit.source_mm) * up + middle * along + wall * out
    # Shadows of the corners on the plane of the detector.
    rays = corners - source
    shadow = source + rays * (unit.source_mm / -(rays @ up))[:, None]
    h = unit.pixel_mm
    half = int(np.ceil(np.abs((shadow - source) @ along).max() / h))
    columns = int(np.ceil((shadow[:, 2] - wall).max() / h))
    first = plane * up + (middle + (0.5 - half) * h) * along + (wall + 0.5 * h) * out
    return Geometry(source, first, h * along, h * out, 2 * half, columns)


def _corners(body: Volume) -> FloatArray:
    """Return the corners of the columns of voxels along z that contain tissue, shape (k, 3).

    All columns span the z range of the whole body, so that its shadow is inside the shadow of the
    corners.
    """
    tissue = body.values != Tissue.AIR
    y, x = np.nonzero(tissue.any(axis=0))
    if not len(y):
        raise InputError("The volume contains only air. Check its labels.")
    z = np.flatnonzero(tissue.any(axis=(1, 2)))
    origin, step = np.asarray(body.origin_mm), np.asarray(body.spacing_mm)
    ends = []
    for dz in (z[0] - 0.5, z[-1] + 0.5):
        for dy in (-0.5, 0.5):
            for dx in (-0.5, 0.5):
                at = np.column_stack([x + dx, y + dy, np.full(len(x), dz)])
                ends.append(origin + at * step)
    return np.concatenate(ends)

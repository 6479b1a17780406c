"""The rotated cylinder of thesis sections 3.3.2 and 3.3.3 (Figs. 3.6 to 3.8).

The axis of rotation is assumed perpendicular to the axis of the cylinder: a rotation about its
own axis would change nothing. The thesis gives no size; here the length is four diameters.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.coefficients.coefficients import coefficients
from palpate.workers.comparison.similarity.score import Surface
from palpate.workers.thesis.scale import Scale, check_scale

LENGTH_MM, RADIUS_MM = 80.0, 10.0
VOXEL_MM: dict[Scale, float] = {"sketch": 1.0, "reduced": 1.0, "full": 0.5}
ANGLES_DEG = (0, 1, 2, *range(5, 180, 5), 178, 179, 180)


@dataclass(frozen=True)
class CylinderRow:
    """A cylinder rotated by an angle, compared with itself.

    Parameters
    ----------
    angle_deg : float
    jc, dc : float
        Jaccard and Dice coefficients.
    mhd_mm : float
        The variant D22.
    gsf : float
        -inf where the voxels are identical.
    """

    angle_deg: float
    jc: float
    dc: float
    mhd_mm: float
    gsf: float


def cylinder(angle_deg: float, voxel_mm: float) -> Volume:
    """Return the voxels of a cylinder whose axis is rotated from x by an angle in the x-y plane.

    A voxel belongs to the cylinder if its centre does. Voxel centres are half a voxel off the
    planes of symmetry, so that a rotation by 180 degrees gives the same voxels.

    Raises
    ------
    InputError
        If the voxel size is not positive.
    """
    if not voxel_mm > 0:
        raise InputError(f"The voxel size must be > 0 mm, got {voxel_mm:g} mm.")
    reach = math.hypot(LENGTH_MM / 2, RADIUS_MM) + voxel_mm
    n, n_z = (2 * math.ceil(r / voxel_mm) for r in (reach, RADIUS_MM + voxel_mm))
    at = (np.arange(n) - (n - 1) / 2) * voxel_mm
    z = ((np.arange(n_z) - (n_z - 1) / 2) * voxel_mm)[:, None, None]
    turn = math.radians(angle_deg)
    # Rounded so that rotations by 90 or 180 degrees are exact.
    c, s = round(math.cos(turn), 15), round(math.sin(turn), 15)
    along = np.abs(c * at[None, :] + s * at[:, None])
    across = (c * at[:, None] - s * at[None, :]) ** 2
    inside = (along <= LENGTH_MM / 2) & (across + z**2 <= RADIUS_MM**2)
    values = np.where(inside, Tissue.GLANDULAR, Tissue.AIR).astype(np.uint8)
    start = (float(at[0]), float(at[0]), float(z[0, 0, 0]))
    return Volume(values, (voxel_mm,) * 3, start)


def cylinder_row(angle_deg: float, voxel_mm: float, surface: Surface = "boundary") -> CylinderRow:
    """Compare the rotated cylinder with the cylinder along x."""
    turned, still = cylinder(angle_deg, voxel_mm), cylinder(0.0, voxel_mm)
    found = coefficients(turned, still, (Tissue.GLANDULAR,), surface)
    return CylinderRow(angle_deg, found.jc, found.dc, found.mhd_mm, found.gsf)


def cylinder_experiment(
    scale: Scale = "reduced", surface: Surface = "boundary"
) -> tuple[CylinderRow, ...]:
    """Rotate the cylinder from 0 to 180 degrees.

    Parameters
    ----------
    scale : {"sketch", "reduced", "full"}
        Voxels of 1 mm, or 0.5 mm at full scale.
    surface : {"boundary", "all"}
        See `workers.comparison.coefficients.coefficients.coefficients`.

    Raises
    ------
    InputError
        If the scale is unknown.
    """
    check_scale(scale)
    return tuple(cylinder_row(angle, VOXEL_MM[scale], surface) for angle in ANGLES_DEG)

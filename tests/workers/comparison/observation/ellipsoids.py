"""Ellipsoids as labels, with their exact properties."""

import numpy as np
from scipy.integrate import dblquad

from palpate.storage.values import Tissue, Volume


def lattice(shape_xyz, spacing_mm):
    """Return the voxel centres of a box about its middle: z, y, x grids and the origin."""
    axes = [(np.arange(n) - (n - 1) / 2) * h for n, h in zip(shape_xyz, spacing_mm, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return x, y, z, tuple(float(axis[0]) for axis in axes)


def inside(grid, half_axes, centre=(0.0, 0.0, 0.0)):
    x, y, z = grid
    a, b, c = half_axes
    return ((x - centre[0]) / a) ** 2 + ((y - centre[1]) / b) ** 2 + ((z - centre[2]) / c) ** 2 < 1


def breast(
    outer=(22.0, 17.0, 14.0),
    glands=(((11.0, 9.0, 7.0), (0.0, 0.0, 0.0)),),
    shift=(0, 0, 0),
    spacing_mm=(0.5, 0.5, 0.5),
    shape=(104, 84, 72),
):
    """Return fat that contains glandular ellipsoids (half axes, centre), all moved by a shift."""
    x, y, z, origin = lattice(shape, spacing_mm)
    shift = np.asarray(shift, float)
    values = np.where(inside((x, y, z), outer, shift), Tissue.FAT, Tissue.AIR).astype(np.uint8)
    for half_axes, centre in glands:
        values[inside((x, y, z), half_axes, centre + shift)] = Tissue.GLANDULAR
    return Volume(values, spacing_mm, origin)


def normals(points, half_axes):
    """Return unit normals, at the points, of the ellipsoid's level sets."""
    slope = points / np.square(half_axes)
    return slope / np.linalg.norm(slope, axis=1, keepdims=True)


def offsets(points, half_axes):
    """Return the distance to the ellipsoid to second order (G. Taubin, IEEE PAMI 13, 1991)."""
    level = np.sum(np.square(points / half_axes), axis=1) - 1
    return level / (2 * np.linalg.norm(points / np.square(half_axes), axis=1))


def area(half_axes):
    """Return the surface area by quadrature over the sphere of directions."""
    a, b, c = half_axes

    def element(phi, theta):
        s, t = np.sin(theta), np.cos(theta)
        across = (b * c * s * np.cos(phi)) ** 2 + (a * c * s * np.sin(phi)) ** 2 + (a * b * t) ** 2
        return s * np.sqrt(across)

    return dblquad(element, 0, np.pi, 0, 2 * np.pi)[0]

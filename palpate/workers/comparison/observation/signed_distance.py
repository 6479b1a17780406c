"""Signed distance to the interface of a tissue, with subvoxel accuracy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.comparison.observation.cubic_interpolation import at_points
from palpate.workers.comparison.observation.isosurface import LEVEL, SMOOTH_VOXELS, Surface, surface
from palpate.workers.comparison.observation.triangle_distance import distances


@dataclass(frozen=True, eq=False)
class SignedDistance:
    """Signed distance on the lattice of a volume.

    Parameters
    ----------
    values : ndarray of float32, shape (nz, ny, nx)
        Distances in mm, negative inside the tissue.
    spacing_mm, origin_mm : tuple of float
        As in `storage.values.Volume`.
    interface_mm2 : float
        Area of the interface.
    """

    values: NDArray[np.float32]
    spacing_mm: Triple
    origin_mm: Triple
    interface_mm2: float

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the signed distance of points and its gradient.

        Parameters
        ----------
        points : ndarray, shape (k, 3)
            (x, y, z) in mm. Outside the lattice, the distance to its box is added.

        Returns
        -------
        distance : ndarray, shape (k,)
            Distances in mm; continuous in the points, and smooth except at the faces of the box.
        gradient : ndarray, shape (k, 3)
            Derivative of the distance; approximately the unit normal close to the interface.

        Raises
        ------
        InputError
            If a point is not finite or the array is not of shape (k, 3).
        """
        points = np.asarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(
                f"Signed distances need finite points of shape (k, 3), got shape {points.shape}"
                f" with {int(np.sum(~np.isfinite(points)))} numbers that are not finite."
            )
        distance, gradient = at_points(self.values, self.spacing_mm, self.origin_mm, points)
        first = np.asarray(self.origin_mm)
        last = first + np.asarray(self.spacing_mm) * (np.array(self.values.shape[::-1]) - 1)
        beyond = points - np.clip(points, first, last)
        outside = np.linalg.norm(beyond, axis=1)
        return distance + outside, gradient + beyond / np.where(outside > 0, outside, 1)[:, None]


def signed_distance(
    labels: Volume,
    inside: tuple[Tissue, ...],
    smooth_voxels: float = SMOOTH_VOXELS,
    band_mm: float = 25.0,
) -> SignedDistance:
    """Return the signed distance of every voxel centre to the interface of a tissue.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    inside : tuple of Tissue
        The enclosed tissues.
    smooth_voxels : float
        Blur of the indicator; see `workers.comparison.observation.isosurface.surface`.
    band_mm : float
        Largest distance, at which values are clipped; > 0.

    Returns
    -------
    SignedDistance
        For its errors see `distances` and `surface` in this package.

    Raises
    ------
    InputError
        If the tissue has no interface in the volume or the band is not positive.
    """
    if not band_mm > 0:
        raise InputError(f"The band of distances must be > 0 mm, found {band_mm}.")
    return distance_to(surface(labels, inside, smooth_voxels), labels, band_mm)


def distance_to(interface: Surface, labels: Volume, band_mm: float) -> SignedDistance:
    """Return the signed distance of every voxel centre to an extracted interface.

    Parameters
    ----------
    interface : Surface
        Interface of a tissue in the labels.
    labels : Volume
        Lattice of the result.
    band_mm : float
        Largest distance, at which values are clipped; > 0.
    """
    step = np.asarray(labels.spacing_mm)
    vertices = interface.vertices - np.asarray(labels.origin_mm)
    values = distances(vertices, interface.triangles, labels.values.shape, step, band_mm)
    box = tuple(
        slice(a, a + n) for a, n in zip(interface.start, interface.field.shape, strict=True)
    )
    values[box] = np.where(interface.field > LEVEL, -values[box], values[box])
    area_mm2 = float(interface.triangle_areas_mm2().sum())
    return SignedDistance(values, labels.spacing_mm, labels.origin_mm, area_mm2)

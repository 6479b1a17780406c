"""Residuals: signed distances of moved material points to the interfaces in a scan."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.observation.interface import (
    Interface,
    InterfacePoints,
    checked_interfaces,
)
from palpate.workers.comparison.observation.isosurface import SMOOTH_VOXELS
from palpate.workers.comparison.observation.signed_distance import SignedDistance, signed_distance


@dataclass(frozen=True, eq=False)
class Observed:
    """The interfaces observed in one deformed state.

    Parameters
    ----------
    distances : tuple of SignedDistance
        Signed distance to each interface, in the order of the points.
    """

    distances: tuple[SignedDistance, ...]


def observe(
    labels: Volume,
    interfaces: Sequence[Interface],
    smooth_voxels: float = SMOOTH_VOXELS,
    band_mm: float = 25.0,
) -> Observed:
    """Measure the interfaces of a deformed label volume.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels of the deformed state.
    interfaces : sequence of Interface
        Interfaces of the points, in the same order.
    smooth_voxels, band_mm : float
        See `workers.comparison.observation.signed_distance.signed_distance`.

    Raises
    ------
    InputError
        If an interface is not in the volume.
    """
    return Observed(
        tuple(signed_distance(labels, i.inside, smooth_voxels, band_mm) for i in interfaces)
    )


def residual(
    points_mm: FloatArray, points: InterfacePoints, observed: Observed
) -> tuple[FloatArray, FloatArray]:
    """Return the signed distances of moved points to their observed interfaces.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
        Positions of the points moved by the model.
    points : InterfacePoints
        Points of the reference scan.
    observed : Observed

    Returns
    -------
    r : ndarray, shape (k,)
        Signed distances in mm; positive if the moved point is outside the observed tissue.
    normals : ndarray, shape (k, 3)
        Derivative of r: ``dr = normals . dx``. Close to the interface, it is approximately the unit
        normal pointing out of the observed tissue.

    Raises
    ------
    InputError
        If the moved points do not match the reference points, or an interface was not observed.
    """
    if np.shape(points_mm) != points.points.shape:
        raise InputError(
            f"Expected the positions of {len(points)} points, got shape {np.shape(points_mm)}."
        )
    checked_interfaces(points.interface, len(observed.distances))
    r = np.empty(len(points))
    normals = np.empty((len(points), 3))
    for number, distance in enumerate(observed.distances):
        own = points.interface == number
        r[own], normals[own] = distance.at(points_mm[own])
    return r, normals

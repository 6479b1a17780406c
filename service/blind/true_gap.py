"""Computes the gap between a fitted model and the truth, without noise.

A diagnosis moves points that it took from a noisy scan, so they lie a little off the true
interfaces, on which the truth is known. Displacement is continuous across them: it is
interpolated in space by cubic radial functions with a linear part (G. E. Fasshauer,
Meshfree Approximation Methods with MATLAB, 2007, chapters 6 and 8), from all interfaces
at once. Taking the displacement of the nearest point of the truth would not do: pressed
by a fifth, a point 0.3 mm off the interface is 0.06 mm elsewhere.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator

from service.blind.truth import Moved
from storage.errors import InputError
from storage.values import FloatArray

# Points of the truth about each point: so many of a curved surface do not lie in a plane.
NEIGHBOURS = 100


@dataclass(frozen=True)
class TrueGap:
    """Root mean square distance along the model's normals, in mm, and of each scan."""

    gap_mm: float
    scans_mm: tuple[float, ...]


def true_gap(
    points: FloatArray, moved: FloatArray, normals: FloatArray, truth: Moved, known: FloatArray
) -> TrueGap:
    """Return how far a model's interfaces are from the true ones.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Of the scan at rest, in mm.
    moved, normals : ndarray, shape (scans, k, 3)
        Where the model puts them, in mm, and unit normals of the interface there.
    truth : Moved
        Of the same scans, in the same order.
    known : ndarray, shape (scans, k)
        Distance along the normals, in mm, that the model is known to be off and that its
        residuals are corrected by; subtracted.

    Raises
    ------
    InputError
        If the scans are not those of the truth, or the truth has too few points.
    """
    true = material_points(points, truth)
    if moved.shape != true.shape or normals.shape != true.shape:
        raise InputError(
            f"The answer has {moved.shape[0]} scans of {moved.shape[1]} points, the truth "
            f"{true.shape[0]} of {true.shape[1]}."
        )
    apart = np.einsum("skc,skc->sk", normals, moved - true) - known
    each = np.sqrt(np.mean(apart**2, axis=1))
    return TrueGap(float(np.sqrt(np.mean(apart**2))), tuple(map(float, each)))


def material_points(points: FloatArray, truth: Moved) -> FloatArray:
    """Return where material points near the interfaces truly went, in mm.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        At rest, in mm.
    truth : Moved

    Returns
    -------
    ndarray, shape (scans, k, 3)

    Raises
    ------
    InputError
        If the truth has too few points.
    """
    at, first = np.unique(truth.points, axis=0, return_index=True)
    if len(at) < NEIGHBOURS:
        raise InputError(
            f"The truth has {len(at)} points, expected at least {NEIGHBOURS} on all interfaces."
        )
    went = np.moveaxis(truth.displacement[:, first], 0, 1)  # (n, scans, 3)
    field = RBFInterpolator(
        at, went.reshape(len(at), -1), neighbors=NEIGHBOURS, kernel="cubic", degree=1
    )
    moved = np.asarray(field(points)).reshape(len(points), -1, 3)
    return np.asarray(points + np.moveaxis(moved, 1, 0))

"""Computes the gap between a fitted model and the truth, without noise.

A diagnosis compares interfaces along their normals, so its gap is one of interfaces: skin that
slides along itself opens none. Of the outline, along which skin slides by millimetres, the true one
is a surface through the points that were on it; of the gland, whose boundary is thin and folded but
goes with the tissue, it is where each point went. Both are given: `TrueGap.material_mm` follows
points everywhere.

Points of a diagnosis come from a noisy scan, so they lie a little off the true interfaces, on which
the truth is known. Displacement is continuous across them: it is interpolated in space by cubic
radial functions with a linear part (G. E. Fasshauer, Meshfree Approximation Methods with MATLAB,
2007, chapters 6 and 8), from all interfaces at once. Taking the displacement of the nearest point
of the truth would not do: pressed by a fifth, a point 0.3 mm off it is 0.06 mm elsewhere.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from palpate.service.blind.sealed.truth import Moved
from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.material_points import OUTLINE

# Points of the truth about each point: so many of a curved surface do not lie in a plane.
NEIGHBOURS = 100
# Points of a surface through which a paraboloid is laid, within some 8 mm where it is known at
# 1500 points; those further out count less, and the last one e^-2.
ON_SURFACE = 20


@dataclass(frozen=True)
class TrueGap:
    """Root mean square distances along the model's normals, in mm.

    Parameters
    ----------
    gap_mm : float
        Of interfaces.
    scans_mm : tuple of float
        The same of each scan.
    material_mm : float
        Of points that go with the tissue.
    """

    gap_mm: float
    scans_mm: tuple[float, ...]
    material_mm: float


def true_gap(
    points: FloatArray,
    interface: IntArray,
    moved: FloatArray,
    normals: FloatArray,
    truth: Moved,
    known: FloatArray,
    pressed: FloatArray | None = None,
) -> TrueGap:
    """Return how far a model's interfaces are from the true ones.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Of the scan at rest, in mm.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    moved, normals : ndarray, shape (scans, k, 3)
        Where the model puts them, in mm, and unit normals of the interface there.
    truth : Moved
        Of the same scans, in the same order.
    known : ndarray, shape (scans, k)
        Distance along the normals, in mm, that the model is known to be off and that its
        residuals are corrected by; subtracted.
    pressed : ndarray, shape (scans, k), optional
        How far each point is on a plate, 0 to 1, where the model flattens what was drawn above
        its surface or below; see `workers.diagnosis.problem.pressed_points`.

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
    material_mm = _rms(apart)
    on = interface == OUTLINE
    if on.any():
        carried = np.ones(apart.shape) if pressed is None else 1.0 - pressed
        off = _off_outline(
            points[on], moved[:, on], normals[:, on], true[:, on], truth, carried[:, on]
        )
        apart[:, on] = off - known[:, on]
    return TrueGap(_rms(apart), tuple(_rms(each) for each in apart), material_mm)


def _off_outline(
    points: FloatArray,
    moved: FloatArray,
    normals: FloatArray,
    true: FloatArray,
    truth: Moved,
    carried: FloatArray,
) -> FloatArray:
    """Return how far outside of the true outline the model puts its own, shape (scans, k).

    Points that a noisy scan has put off the outline at rest are moved by as much as tissue between
    them and their feet on it, as far as the model carries that along, (scans, k).
    """
    on = truth.interface == OUTLINE
    at_rest, went = truth.points[on], truth.displacement[:, on]
    across = _normals(points, at_rest)
    feet = points - _height(points, across, at_rest)[:, None] * across
    own = moved + carried[:, :, None] * (material_points(feet, truth) - true)
    each = zip(own, normals, went, strict=True)
    return np.stack([_height(p, n, at_rest + u) for p, n, u in each])


def _height(points: FloatArray, normals: FloatArray, surface: FloatArray) -> FloatArray:
    """Return how far above a surface points lie along their normals, shape (k,), in mm.

    The surface is a paraboloid through the nearest of the points that are known on it, (n, 3).
    """
    distance, nearest = KDTree(surface).query(points, k=ON_SURFACE)
    distance, away = np.asarray(distance), surface[nearest] - points[:, None]
    radius = distance[:, -1:]
    up = np.einsum("knc,kc->kn", away, normals)
    u, v = (np.einsum("knc,kc->kn", away, t) / radius for t in _tangents(normals))
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    weighted = terms * np.exp(-2 * (distance / radius) ** 2)[:, :, None]
    curvature = np.einsum("kna,knb->kab", weighted, terms)
    right = np.einsum("kna,kn->ka", weighted, up)
    return np.asarray(-np.linalg.solve(curvature, right[:, :, None])[:, 0, 0])


def _tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors across each normal, shape (k, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return first, np.cross(normals, first)


def _normals(points: FloatArray, surface: FloatArray) -> FloatArray:
    """Return normals of a surface beside points, of either sign, shape (k, 3)."""
    _, nearest = KDTree(surface).query(points, k=ON_SURFACE)
    patches = surface[nearest]
    patches = patches - patches.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.svd(patches, full_matrices=False)[2][:, 2])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


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

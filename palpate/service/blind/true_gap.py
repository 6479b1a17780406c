"""Gaps to the true interfaces of a body: of a fitted model without noise, and of drawn interfaces.

A diagnosis compares interfaces along their normals, so tangential sliding of the skin opens no gap.
The true outline, along which skin slides by millimetres, is a surface through the displaced outline
points. The boundary of the gland is thin and folded but moves with the tissue, so it is followed
point by point. Both are given: `TrueGap.material_mm` follows points everywhere.

The points of a diagnosis come from a noisy scan, so they are slightly off the true interfaces on
which the truth is known. Displacement is continuous across them: it is interpolated in space by
cubic radial functions with a linear part (G. E. Fasshauer, Meshfree Approximation Methods with
MATLAB, 2007, chapters 6 and 8), from all interfaces at once. The displacement of the nearest true
point is not accurate enough: at 20 % compression, a point 0.3 mm off is displaced by 0.06 mm more.

The distances from the true interfaces to the drawn ones are due to labels or scans that are too
large, and to displaced scans.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from palpate.service.blind.case_truth import CATALOGUE, Moved
from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Tissue, Triple
from palpate.workers.blind.case_body import OUTLINE
from palpate.workers.mechanics.fem.boundary_value_problem import Frame

# Number of nearest true points; this many points of a curved surface are not in a plane.
NEIGHBOURS = 100
# Points for fitting a paraboloid, within about 8 mm if 1500 points are known; more distant ones
# have less weight, the last e^-2.
ON_SURFACE = 20


@dataclass(frozen=True)
class TrueGap:
    """Root mean square distances along the model's normals, in mm.

    Parameters
    ----------
    gap_mm : float
        At the interfaces.
    scans_mm : tuple of float
        The same distance for each scan.
    material_mm : float
        At points that move with the tissue.
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
    """Return the distances of a model's interfaces from the true ones.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points of the scan at rest, in mm.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    moved, normals : ndarray, shape (scans, k, 3)
        Their positions in the model, in mm, and unit normals of the interface there.
    truth : Moved
        Truth of the same scans, in the same order.
    known : ndarray, shape (scans, k)
        Known error of the model along the normals, in mm, for which its residuals are
        corrected; subtracted.
    pressed : ndarray, shape (scans, k), optional
        Degree of contact of each point with a plate, 0 to 1; the model flattens points drawn
        above or below the surface there; see `workers.diagnosis.problem.scan_noise`.

    Raises
    ------
    InputError
        If scans and truth do not match, or the truth has too few points.
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
    """Return the distance of the model's outline outside the true one, shape (scans, k).

    Points that noise has shifted off the outline at rest are moved like the tissue between them and
    their projections onto it, scaled by `carried`, shape (scans, k).
    """
    on = truth.interface == OUTLINE
    at_rest, went = truth.points[on], truth.displacement[:, on]
    across = _normals(points, at_rest)
    feet = points - _height(points, across, at_rest)[:, None] * across
    own = moved + carried[:, :, None] * (material_points(feet, truth) - true)
    each = zip(own, normals, went, strict=True)
    return np.stack([_height(p, n, at_rest + u) for p, n, u in each])


def _height(points: FloatArray, normals: FloatArray, surface: FloatArray) -> FloatArray:
    """Return the height of points above a surface along their normals, shape (k,), in mm.

    The surface is a paraboloid through the nearest of its known points, (n, 3).
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
    """Return two unit vectors perpendicular to each normal, shape (k, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return first, np.cross(normals, first)


def _normals(points: FloatArray, surface: FloatArray) -> FloatArray:
    """Return normals of a surface near points, of either sign, shape (k, 3)."""
    _, nearest = KDTree(surface).query(points, k=ON_SURFACE)
    patches = surface[nearest]
    patches = patches - patches.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.svd(patches, full_matrices=False)[2][:, 2])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def material_points(points: FloatArray, truth: Moved) -> FloatArray:
    """Return the true positions of material points near the interfaces, in mm.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Positions at rest, in mm.
    truth : Moved

    Returns
    -------
    ndarray, shape (scans, k, 3)

    Raises
    ------
    InputError
        If the truth has too few points.
    """
    places, first = np.unique(truth.points, axis=0, return_index=True)
    if len(places) < NEIGHBOURS:
        raise InputError(
            f"The truth has {len(places)} points, expected at least {NEIGHBOURS} on all interfaces."
        )
    went = np.moveaxis(truth.displacement[:, first], 0, 1)  # (n, scans, 3)
    field = RBFInterpolator(
        places, went.reshape(len(places), -1), neighbors=NEIGHBOURS, kernel="cubic", degree=1
    )
    moved = np.asarray(field(points)).reshape(len(points), -1, 3)
    return np.asarray(points + np.moveaxis(moved, 1, 0))


def drawn_mm(
    points: FloatArray,
    normals: FloatArray,
    interface: IntArray,
    centre_mm: Triple,
    sizes: Mapping[str, float],
) -> FloatArray:
    """Return the distance along the normals, shape (scans, k).

    Parameters
    ----------
    points, normals : ndarray, shape (scans, k, 3)
        Points in the loaded scans, in mm, and unit normals of the interfaces there.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    centre_mm : tuple of float
        Centre about which scans are scaled, sheared or turned.
    sizes : mapping of str to float
        Parameters of the catalogue under their external names; missing ones are 0.
    """
    tissues = np.where(interface == 0, Tissue.FAT, Tissue.GLANDULAR)
    frame = Frame(centre_mm)
    out = np.zeros(points.shape[:2])
    for effect in CATALOGUE.on_observation:
        values = {
            p.name: p.unit.to_inside(sizes[p.door_name])
            for p in effect.parameters
            if p.door_name in sizes
        }
        for scan, (place, normal) in enumerate(zip(points, normals, strict=True)):
            out[scan] += effect.shift(place, normal, tissues, values, frame)
    return out

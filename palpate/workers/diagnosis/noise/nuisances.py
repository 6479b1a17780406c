r"""Nuisances that change residuals without a gap, as columns with a normal prior of unit deviation.

Every hypothesis includes them, even "no gap": changes that they can absorb are not evidence.

- **Pose**: each scan may be offset from the position in its header by a registration error, with
  six rigid columns for each scan. The scan at rest has an equal error; since the points are taken
  from it, that error is common to all loaded scans.
- **Drawing**: an interface may be drawn too large or too small as a whole, in one scan or in all.
- **Numerical error**: another mesh, element or contact model moves the interfaces smoothly, by an
  amount that grows with their displacement, in a pattern that depends on the load direction.
"""

from collections.abc import Sequence

import numpy as np

from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.diagnosis.algebra.low_rank import pivoted
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.observation import rigid_columns


def pose_columns(
    points: Sequence[FloatArray],
    normals: Sequence[FloatArray],
    centre_mm: Triple,
    shift_sd_mm: float,
    turn_sd_deg: float,
) -> FloatArray:
    """Return derivatives of all residuals with respect to uncorrelated poses, shape (s k, 6 s).

    `correlated` converts these poses to the poses of the scans.

    Parameters
    ----------
    points, normals : sequence of ndarray, shape (k, 3)
        Points of the interfaces and their unit normals, for each of s scans.
    centre_mm : tuple of float
        Centre of rotation of a scan.
    shift_sd_mm, turn_sd_deg : float
        Standard deviations along and about each axis; zero for scans in their exact position.
    """
    sd = np.repeat([shift_sd_mm, turn_sd_deg], 3)
    each = [rigid_columns(p, n, centre_mm) * sd for p, n in zip(points, normals, strict=True)]
    poses = _block_diagonal(each).reshape(len(each[0]) * len(each), len(each), 6)
    return np.einsum("mtc,ts->msc", poses, _pose_factor(len(each))).reshape(len(poses), -1)


def correlated(poses: FloatArray) -> FloatArray:
    """Return the poses of s scans relative to the scan at rest, from uncorrelated poses, (s, 6).

    Both are in prior standard deviations of the pose of one scan.
    """
    return np.asarray(_pose_factor(len(poses)) @ poses)


def _pose_factor(scans: int) -> FloatArray:
    """Return the Cholesky factor of the poses' covariance: own errors plus a common error."""
    return np.asarray(np.linalg.cholesky(np.eye(scans) + 1.0))


def drawing_columns(
    interface: IntArray, scans: int, common_sd_mm: float, each_sd_mm: float
) -> FloatArray:
    """Return columns for contour bias of i interfaces, shape (s k, i (s + 1)).

    Parameters
    ----------
    interface : ndarray of int, shape (k,)
        Interface of each point.
    scans : int
        Number s of scans.
    common_sd_mm, each_sd_mm : float
        Standard deviations of the bias common to all scans (from the reference scan), and of each
        scan's own bias.
    """
    own = np.equal.outer(interface, np.unique(interface)).astype(np.float64)
    common = np.tile(own, (scans, 1))
    return np.hstack([common_sd_mm * common, each_sd_mm * _block_diagonal([own] * scans)])


def smooth_columns(
    points: FloatArray,
    normals: FloatArray,
    states: IntArray,
    sd_mm: FloatArray,
    length_mm: float,
    state_correlation: float | FloatArray,
    tolerance: float = SETTINGS.numerical.rank_tolerance,
) -> FloatArray:
    r"""Return columns whose outer product is the covariance of a smooth displacement.

    .. math:: s_i s_j T_{ij} (n_i \cdot n_j) \exp(-|X_i - X_j|^2 / 2 l^2)

    Parameters
    ----------
    points, normals : ndarray, shape (m, 3)
        Point and unit normal of each residual.
    states : ndarray of int, shape (m,)
    sd_mm : ndarray, shape (m,)
        Standard deviation s of the displacement.
    length_mm : float
    state_correlation : float or ndarray, shape (s, s)
        Correlation T between any two states, or between each pair; 1 within a state.
    tolerance : float
        Fraction of a variance that may be neglected.
    """
    found = smooth_covariance(points, normals, states, length_mm, state_correlation)
    return sd_mm[:, None] * pivoted(found, tolerance)


def smooth_covariance(
    points: FloatArray,
    normals: FloatArray,
    states: IntArray,
    length_mm: float,
    state_correlation: float | FloatArray,
) -> FloatArray:
    """Return the covariance of a smooth displacement of unit deviation, shape (m, m)."""
    scaled = points / length_mm
    squares = (scaled**2).sum(axis=1)
    distance = np.maximum(squares[:, None] + squares - 2.0 * scaled @ scaled.T, 0.0)
    found = np.exp(-0.5 * distance) * (normals @ normals.T)
    T = np.asarray(state_correlation)
    between = T[np.ix_(states, states)] if T.ndim else T
    found *= np.where(states[:, None] == states, 1.0, between)
    return np.asarray(found)


def _block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    k, q = blocks[0].shape
    found = np.zeros((len(blocks), k, len(blocks), q))
    for s, block in enumerate(blocks):
        found[s, :, s] = block
    return found.reshape(len(blocks) * k, len(blocks) * q)

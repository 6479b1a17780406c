r"""What moves residuals without being a gap, as columns with a normal prior of unit deviation.

Every hypothesis has them, "no gap" included: what they can take up is no evidence of anything.

- **Pose**: each scan may lie elsewhere than its header says, as far as a registration leaves it:
  six rigid columns a scan.
- **Drawing**: an interface may be drawn too large or too small as a whole, in one scan or in all.
- **Numerical error**: another mesh, element or contact moves the interfaces smoothly, the more,
  the more the load moves them, and in another way where the load comes from another side.
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
    """Return what a motion of each scan does to all residuals, shape (s k, 6 s).

    Parameters
    ----------
    points, normals : sequence of ndarray, shape (k, 3)
        Of each of s scans: where its interfaces are, and their unit normals.
    centre_mm : tuple of float
        About which a scan turns.
    shift_sd_mm, turn_sd_deg : float
        Along and about each axis; zero for scans that lie where they should.
    """
    sd = np.repeat([shift_sd_mm, turn_sd_deg], 3)
    each = [rigid_columns(p, n, centre_mm) * sd for p, n in zip(points, normals, strict=True)]
    return _block_diagonal(each)


def drawing_columns(
    interface: IntArray, scans: int, common_sd_mm: float, each_sd_mm: float
) -> FloatArray:
    """Return what interfaces drawn too large do, shape (s k, i (s + 1)), for i interfaces.

    Parameters
    ----------
    interface : ndarray of int, shape (k,)
        Of each point.
    scans : int
        Their number s.
    common_sd_mm, each_sd_mm : float
        Of the bias in all scans, which is that of the reference scan, and in each one.
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
        Of each residual.
    states : ndarray of int, shape (m,)
    sd_mm : ndarray, shape (m,)
        The displacement's standard deviation s there.
    length_mm : float
    state_correlation : float or ndarray, shape (s, s)
        T between any two states, or of each pair; 1 within one.
    tolerance : float
        Part of a variance that may be missing.
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

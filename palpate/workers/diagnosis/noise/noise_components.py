r"""Components of the noise: segmentation, poses, contour bias and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0 S + N N' + M M',

with the covariance C_0 of the segmentation as stated in the case; its scales S, one for each
interface, which `noise_scale` learns; N the columns for poses and contour bias, and M the columns
of the numerical error.

Nuisances change residuals without a gap. They are columns with a normal prior of unit deviation,
and every hypothesis includes them, even "no gap": changes that they can absorb are not evidence.

- **Pose**: each scan may be offset from the position in its header by a registration error, with
  six rigid columns for each scan. The scan at rest has an equal error; since the points are taken
  from it, that error is common to all loaded scans.
- **Drawing**: an interface may be drawn too large or too small as a whole, in one scan or in all.
- **Numerical error**: another mesh, element or contact model moves the interfaces smoothly, by an
  amount that grows with their displacement, in a pattern that depends on the load direction.

Smooth covariances are kept as low-rank factors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpstrf

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.mechanics.effects.observation_effects import rigid_columns


def pivoted(covariance: FloatArray, tolerance: float) -> FloatArray:
    """Return U, shape (m, rank), with ``U U'`` equal to a covariance up to a small diagonal.

    Pivoted Cholesky factorisation, stopped when the remaining variance falls below the tolerance
    (H. Harbrecht, M. Peters and R. Schneider, Appl. Numer. Math. 62 (2012) 428).
    """
    factor, pivots, rank, _ = dpstrf(covariance, tol=tolerance, lower=1)
    U = np.empty((len(covariance), rank))
    U[pivots - 1] = np.tril(factor[:, :rank])
    return U


@dataclass(frozen=True, eq=False)
class LearntNoise:
    """The noise of the residuals.

    Parameters
    ----------
    stated : ndarray, shape (m, m)
        Covariance of the segmentation as stated; residuals of different groups are uncorrelated.
    groups : ndarray of int, shape (m,)
        Interface of each residual; residuals of one interface share a scale.
    fixed : ndarray, shape (m, q)
        Columns of contour bias.
    numerical : ndarray, shape (m, r)
        Columns of the numerical error.
    scales : ndarray, shape (groups,)
        Standard deviation of the segmentation divided by the stated value.

    Raises
    ------
    InputError
        If shapes do not match.
    """

    stated: FloatArray
    groups: IntArray
    fixed: FloatArray
    numerical: FloatArray
    scales: FloatArray

    def __post_init__(self) -> None:
        m = len(self.groups)
        rows = len(self.fixed), len(self.numerical)
        if self.stated.shape != (m, m) or rows != (m, m):
            raise InputError(
                f"The noise of {m} residuals needs a covariance of shape ({m}, {m}) and columns of "
                f"{m} rows; found {self.stated.shape} and {rows} rows."
            )

    @cached_property
    def scatter(self) -> FloatArray:
        """Covariance without the contour bias, shape (m, m), in mm^2."""
        s = self.scales[self.groups]
        return np.asarray(self.stated * s[:, None] * s + self.numerical @ self.numerical.T)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the residuals, without poses, shape (m, m), in mm^2."""
        return np.asarray(self.scatter + self.fixed @ self.fixed.T)


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
    covariance = smooth_covariance(points, normals, states, length_mm, state_correlation)
    return sd_mm[:, None] * pivoted(covariance, tolerance)


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
    covariance = np.exp(-0.5 * distance) * (normals @ normals.T)
    T = np.asarray(state_correlation)
    between = T[np.ix_(states, states)] if T.ndim else T
    covariance *= np.where(states[:, None] == states, 1.0, between)
    return np.asarray(covariance)


def _block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    k, q = blocks[0].shape
    found = np.zeros((len(blocks), k, len(blocks), q))
    for s, block in enumerate(blocks):
        found[s, :, s] = block
    return found.reshape(len(blocks) * k, len(blocks) * q)

r"""Components of the noise: segmentation, poses, contour bias and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0(l) S + N N' + \tau^2 M M',

with the covariance C_0 given in the case, of correlation length l; scales S of the segmentation,
one for each interface; N the columns for poses and contour bias, and M the columns of the numerical
error. Scales, l and tau have priors around the given or assumed values;
`noise_learning` finds their likely values, and
`workers.diagnosis.noise.averaged_evidence` averages the evidence of a hypothesis over them.

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
class NoiseParts:
    """Components of the noise of the residuals.

    Parameters
    ----------
    stated : tuple of ndarray, shape (m, m)
        Covariance of the segmentation for each correlation length; residuals of different groups
        are uncorrelated.
    lengths : tuple of float
        Correlation lengths divided by the given length.
    groups : ndarray of int, shape (m,)
        Interface of each residual; residuals of one interface share a scale.
    fixed : ndarray, shape (m, q)
        Columns of nuisances.
    numerical : ndarray, shape (m, r)
        Columns of the numerical error at its assumed size.
    uneven : ndarray, shape (m,), optional
        Segmentation noise of each residual relative to the noise in the middle of the body, already
        included in `stated`; see `noise_learning`. None if uneven noise was not
        learnt.

    Raises
    ------
    InputError
        If shapes do not match.
    """

    stated: tuple[FloatArray, ...]
    lengths: tuple[float, ...]
    groups: IntArray
    fixed: FloatArray
    numerical: FloatArray
    uneven: FloatArray | None = None

    def __post_init__(self) -> None:
        m = len(self.groups)
        shapes = {one.shape for one in self.stated} | {(m, len(self.numerical))}
        if shapes != {(m, m)} or len(self.fixed) != m or len(self.lengths) != len(self.stated):
            raise InputError(
                f"The noise of {m} residuals needs covariances of shape ({m}, {m}), one for each "
                f"length, and columns of {m} rows; found {shapes}, {len(self.lengths)} lengths and "
                f"{len(self.fixed)} rows."
            )

    @property
    def size(self) -> int:
        """The number of residuals, m."""
        return len(self.groups)

    @property
    def factors(self) -> FloatArray:
        """Noise of each residual relative to the noise in the middle of the body, shape (m,)."""
        return np.ones(self.size) if self.uneven is None else self.uneven

    def scatter(self, length: int, scales: FloatArray, numerical: float) -> FloatArray:
        """Return the covariance of segmentation and numerical errors, shape (m, m)."""
        s = scales[self.groups]
        found = self.stated[length] * s[:, None] * s
        return np.asarray(found + numerical**2 * self.numerical @ self.numerical.T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseState:
    """One possible state of the noise.

    Parameters
    ----------
    length : int
        Index of the correlation length.
    scales : ndarray, shape (groups,)
        Standard deviation of the segmentation divided by the given value.
    numerical : float
        Numerical error divided by its assumed value.
    log_weight : float
        Log prior of the state.
    share : float
        Probability of the state when the noise was learnt.
    """

    length: int
    scales: FloatArray
    numerical: float
    log_weight: float
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class LearntNoise:
    """The noise of a calibrated problem.

    Parameters
    ----------
    parts : NoiseParts
    states : tuple of NoiseState
        States, the likeliest first; see `learnt_states`.
    """

    parts: NoiseParts
    states: tuple[NoiseState, ...]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the residuals in the likeliest state, shape (m, m), in mm^2."""
        return self.scatter + self.parts.fixed @ self.parts.fixed.T

    @property
    def scatter(self) -> FloatArray:
        """Covariance without the nuisances, shape (m, m), in mm^2."""
        best = self.states[0]
        return self.parts.scatter(best.length, best.scales, best.numerical)


def believed(parts: NoiseParts) -> LearntNoise:
    """Return the noise as given in the case, with a numerical error of the assumed size."""
    scales = np.ones(int(parts.groups.max()) + 1)
    return LearntNoise(parts, (NoiseState(parts.lengths.index(1.0), scales, 1.0, 0.0),))


def weighted_sum(weights: FloatArray, parts: Sequence[FloatArray]) -> FloatArray:
    """Return the weighted sum of matrices of equal shape."""
    return np.asarray(sum(w * part for w, part in zip(weights, parts, strict=True)))


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

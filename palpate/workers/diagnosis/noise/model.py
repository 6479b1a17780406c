r"""Components of the noise: segmentation, poses, contour bias and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0(l) S + N N' + \tau^2 M M',

with the covariance C_0 given in the case, of correlation length l; scales S of the segmentation,
one for each interface; N the columns of `diagnosis.noise.nuisances` for poses and contour bias, and
M the columns of the numerical error. Scales, l and tau have priors around the given or assumed
values; `workers.diagnosis.noise.learning` finds their likely values, and
`workers.diagnosis.noise.evidence` averages the evidence of a hypothesis over them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray


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
        included in `stated`; see `workers.diagnosis.noise.uneven`. None if uneven noise was not
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

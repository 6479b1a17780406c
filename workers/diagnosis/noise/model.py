r"""Components of the noise: segmentation, poses, contour bias and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0(l) S + N N' + \tau^2 M M',

with the covariance C_0 stated in the case, of correlation length l; scales S of the segmentation,
one for each interface; N the columns of `diagnosis.noise.nuisances` for poses and contour bias, and
M the columns of the numerical error. Scales, l and tau have priors around the stated or assumed
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
        Covariance of the segmentation for each correlation length; residuals of different
        groups do not correlate.
    lengths : tuple of float
        These lengths divided by the stated one.
    groups : ndarray of int, shape (m,)
        Interface of each residual; residuals of one interface share a scale.
    fixed : ndarray, shape (m, q)
        Columns of nuisances.
    numerical : ndarray, shape (m, r)
        Columns of the numerical error, of the assumed size.
    uneven : ndarray, shape (m,), optional
        Segmentation noise at each residual relative to the middle of the body, already included in
        `stated`; see `workers.diagnosis.noise.uneven`. None if it is not learnt.

    Raises
    ------
    InputError
        If shapes disagree.
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
                f"The noise of {m} residuals needs covariances ({m}, {m}), one for each length, "
                f"and columns of {m} rows; found {shapes}, {len(self.lengths)} lengths and "
                f"{len(self.fixed)} rows."
            )

    @property
    def size(self) -> int:
        """Number of residuals m."""
        return len(self.groups)

    @property
    def factors(self) -> FloatArray:
        """Noise at each residual relative to the middle of the body, shape (m,)."""
        return np.ones(self.size) if self.uneven is None else self.uneven

    def scatter(self, length: int, scales: FloatArray, numerical: float) -> FloatArray:
        """Return the covariance of segmentation and numerical error, shape (m, m)."""
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
        Standard deviation of the segmentation divided by the stated one.
    numerical : float
        Numerical error divided by the assumed one.
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
        The likeliest first; see `learnt_states`.
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
    """Return known noise: the stated one, with a numerical error of the assumed size."""
    scales = np.ones(int(parts.groups.max()) + 1)
    return LearntNoise(parts, (NoiseState(parts.lengths.index(1.0), scales, 1.0, 0.0),))


def weighted_sum(weights: FloatArray, parts: Sequence[FloatArray]) -> FloatArray:
    """Return the weighted sum of matrices of one shape."""
    return np.asarray(sum(w * part for w, part in zip(weights, parts, strict=True)))

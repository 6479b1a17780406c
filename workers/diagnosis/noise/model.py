r"""What noise is made of: segmentation, poses and drawing, and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0(l) S + N N' + \tau^2 M M',

with the covariance C_0 that the case states, of correlation length l; scales S of the segmentation,
one for each interface; N the columns of `diagnosis.noise.nuisances` for poses and drawing, and M
those of the numerical error. Scales, l and tau have priors around what is stated or believed:
`workers.diagnosis.noise.learning` finds what they may be, and `workers.diagnosis.noise.evidence`
averages the evidence of a hypothesis over that.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class NoiseParts:
    """What the noise of the residuals is made of.

    Parameters
    ----------
    stated : tuple of ndarray, shape (m, m)
        Covariance of the segmentation for each correlation length; residuals of different
        groups do not correlate.
    lengths : tuple of float
        These lengths over the stated one.
    groups : ndarray of int, shape (m,)
        Residuals that share a scale: of one interface.
    fixed : ndarray, shape (m, q)
        Nuisances.
    numerical : ndarray, shape (m, r)
        Numerical error, of the size that is believed.
    uneven : ndarray, shape (m,), optional
        By how much the segmentation errs more at each residual than in the middle of the body,
        which `stated` contains; see `workers.diagnosis.noise.uneven`. None where that is not
        learnt.

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
        """Deviation at each residual over that in the middle of the body, shape (m,)."""
        return np.ones(self.size) if self.uneven is None else self.uneven

    def scatter(self, length: int, scales: FloatArray, numerical: float) -> FloatArray:
        """Return the covariance of segmentation and numerical error, shape (m, m)."""
        s = scales[self.groups]
        found = self.stated[length] * s[:, None] * s
        return np.asarray(found + numerical**2 * self.numerical @ self.numerical.T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseState:
    """One point of the average.

    Parameters
    ----------
    length : int
        Number of the correlation length.
    scales : ndarray, shape (groups,)
        Of the segmentation's standard deviation, over what is stated.
    numerical : float
        Of the numerical error, over what is believed.
    log_weight : float
        Logarithm of its prior.
    share : float
        Its probability, of all states, when the noise was learnt.
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
        """Of the residuals in the likeliest state, shape (m, m), in mm^2."""
        return self.scatter + self.parts.fixed @ self.parts.fixed.T

    @property
    def scatter(self) -> FloatArray:
        """The same without the nuisances."""
        best = self.states[0]
        return self.parts.scatter(best.length, best.scales, best.numerical)


def believed(parts: NoiseParts) -> LearntNoise:
    """Return noise that is known: as stated, and a numerical error of the size believed."""
    scales = np.ones(int(parts.groups.max()) + 1)
    return LearntNoise(parts, (NoiseState(parts.lengths.index(1.0), scales, 1.0, 0.0),))


def weighted_sum(weights: FloatArray, parts: Sequence[FloatArray]) -> FloatArray:
    """Return the sum of matrices of one shape, each times its weight."""
    return np.asarray(sum(w * part for w, part in zip(weights, parts, strict=True)))

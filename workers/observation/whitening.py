r"""Residuals made independent, without the covariance of all states at once.

The states differ from their mean independently: with an orthonormal matrix H whose
first row is constant, the covariance of `workers.observation.noise` falls into one
block ``(s^2 + S s_ref^2) K + nu^2 1`` for the mean of the S states and S - 1 blocks
``s^2 K + nu^2 1``, and each of them into one block an interface. So the largest
matrix to be factored has the points of one interface, not all residuals.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, helmert, solve_triangular

from storage.errors import InputError
from storage.values import FloatArray
from workers.observation.interface import InterfacePoints
from workers.observation.noise import SegmentationNoise, correlation


@dataclass(frozen=True, eq=False)
class Whitening:
    """A factor of the covariance C of all residuals.

    Parameters
    ----------
    states, points : int
        S deformed scans, k points.
    blocks : tuple of (index, mean, rest)
        For each interface the numbers of its points and the lower Cholesky factors of
        the covariance of the states' mean (times sqrt S) and of each difference.
    log_det : float
        Logarithm of the determinant of C (mm^2).
    """

    states: int
    points: int
    blocks: tuple[tuple[NDArray[np.intp], FloatArray, FloatArray], ...]
    log_det: float

    def whiten(self, values: FloatArray) -> FloatArray:
        """Apply W with ``W C W^T = 1``, so that ``|W r|^2 = r^T C^-1 r``.

        Parameters
        ----------
        values : ndarray, shape (S * k,) or (S * k, n)
            Residuals, or their derivatives by n parameters; row ``s * k + i`` is point
            i in state s.

        Raises
        ------
        InputError
            If the number of rows is another.
        """
        rows = self.states * self.points
        if len(values) != rows:
            raise InputError(
                f"{self.states} states of {self.points} points have {rows} residuals, "
                f"got {len(values)}."
            )
        by_state = np.reshape(values, (self.states, self.points, -1))
        turned = np.tensordot(helmert(self.states, full=True), by_state, axes=1)
        for index, mean, rest in self.blocks:
            for s in range(self.states):
                factor = mean if s == 0 else rest
                turned[s, index] = solve_triangular(factor, turned[s, index], lower=True)
        return np.asarray(turned.reshape(np.shape(values)))


def whitening(points: InterfacePoints, noise: SegmentationNoise, states: int) -> Whitening:
    """Factor the covariance of the residuals of all states.

    Parameters
    ----------
    points : InterfacePoints
    noise : SegmentationNoise
    states : int
        >= 1.

    Raises
    ------
    InputError
        If there is no state.
    """
    if states < 1:
        raise InputError(f"A covariance needs at least one deformed scan, found {states}.")
    blocks = []
    log_det = 0.0
    for number in np.unique(points.interface):
        index = np.flatnonzero(points.interface == number)
        smooth = correlation(points.of(index), noise.correlation_mm)
        mean, rest = (
            cholesky(variance * smooth + noise.nugget_mm**2 * np.eye(len(index)), lower=True)
            for variance in (noise.sd_mm**2 + states * noise.reference_sd_mm**2, noise.sd_mm**2)
        )
        blocks.append((index, mean, rest))
        log_det += 2 * np.log(np.diag(mean)).sum()
        log_det += 2 * (states - 1) * np.log(np.diag(rest)).sum()
    return Whitening(states, len(points), tuple(blocks), float(log_det))

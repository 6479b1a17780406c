r"""A smooth random displacement field: "something else than what is listed".

The residual gains a normal field with covariance

.. math:: a^2 \, T_{st} \, (n_i \cdot n_j) \, \exp(-|X_i - X_j|^2 / 2 l^2),

an unknown displacement seen along the normals, with T = 1 within a state and 0.8 between
states (the model discrepancy of M. C. Kennedy and A. O'Hagan, J. R. Stat. Soc. B 63
(2001) 425). Amplitudes and lengths are averaged over; the parameters are integrated out.

For one length the covariance is factored once by Cholesky with pivoting, stopped where the
variance that is left falls below a tolerance (H. Harbrecht, M. Peters and R. Schneider,
Appl. Numer. Math. 62 (2012) 428). Woodbury's identity then gives every amplitude and every
hypothesis from systems of the size of its rank.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpstrf
from scipy.special import logsumexp

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, IntArray
from workers.diagnosis.evidence import Quadratic, log_marginal
from workers.diagnosis.gap import LinearFit
from workers.diagnosis.linearisation import Linearised
from workers.diagnosis.settings import SETTINGS


@dataclass(frozen=True, slots=True)
class SmoothField:
    """What is believed of the field before data.

    Parameters
    ----------
    amplitudes_mm, lengths_mm : tuple of float
        Standard deviations of the displacement along any direction, and correlation
        lengths; all pairs are equally probable.
    state_correlation : float
        Between two states, 0 to 1.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    amplitudes_mm: tuple[float, ...] = SETTINGS.smooth_field.amplitudes_mm
    lengths_mm: tuple[float, ...] = SETTINGS.smooth_field.lengths_mm
    state_correlation: float = SETTINGS.smooth_field.state_correlation

    def __post_init__(self) -> None:
        scales = self.amplitudes_mm + self.lengths_mm
        usable = self.amplitudes_mm and self.lengths_mm and min(scales) > 0
        if not usable or not 0 <= self.state_correlation <= 1:
            raise InputError(
                "A smooth field needs amplitudes > 0, lengths > 0 and a correlation between "
                f"states from 0 to 1, found {self}."
            )

    def covariance(
        self, points: FloatArray, normals: FloatArray, states: IntArray, length_mm: float
    ) -> FloatArray:
        """Return that of a field of unit amplitude at all residuals, shape (m, m)."""
        scaled = points / length_mm
        squares = (scaled**2).sum(axis=1)
        distance = np.maximum(squares[:, None] + squares - 2.0 * scaled @ scaled.T, 0.0)
        found = np.exp(-0.5 * distance) * (normals @ normals.T)
        found *= np.where(states[:, None] == states, 1.0, self.state_correlation)
        return np.asarray(found)


class Ceiling(NamedTuple):
    """How much of the gap a free smooth field would explain.

    Parameters
    ----------
    share : float
        Of the squared gap, 0 to 1; nan without a gap.
    amplitude_mm, length_mm : float
        Of the field with the largest evidence.
    field_mm : ndarray, shape (m,)
        Its posterior mean along the normals: what it takes from the residuals.
    """

    share: float
    amplitude_mm: float
    length_mm: float
    field_mm: FloatArray


class Discrepancy:
    """The field over given points, ready for any hypothesis that has them.

    Making it costs seconds for 4,000 residuals, asking it a fraction of one. The normals
    of the nominal fit serve for all refits.

    Parameters
    ----------
    points : ndarray, shape (m, 3)
        Reference position of each residual, in mm.
    normals : ndarray, shape (m, 3)
        Unit normals along which it was measured.
    states : ndarray of int, shape (m,)
    covariance_factor : ndarray, shape (m, m)
        Of the noise, as in `Linearised`.
    prior : SmoothField
    tolerance : float
        Variance that the low rank may miss at a point.

    Raises
    ------
    InputError
        If shapes disagree.
    """

    def __init__(
        self,
        points: FloatArray,
        normals: FloatArray,
        states: IntArray,
        covariance_factor: FloatArray,
        prior: SmoothField | None = None,
        tolerance: float = SETTINGS.smooth_field.rank_tolerance,
    ) -> None:
        m = len(covariance_factor)
        shapes = points.shape, normals.shape, states.shape
        if shapes != ((m, 3), (m, 3), (m,)):
            raise InputError(
                f"A discrepancy of {m} residuals needs points ({m}, 3), normals ({m}, 3) and "
                f"states ({m},), found {shapes}."
            )
        self.prior = prior or SmoothField()
        self.size = m
        self._bases: list[FloatArray] = []
        self._factors: list[list[FloatArray]] = []
        for length in self.prior.lengths_mm:
            covariance = self.prior.covariance(points, normals, states, length)
            low_rank = _pivoted(covariance, tolerance)
            W = solve_triangular(covariance_factor, low_rank, lower=True, check_finite=False)
            gram = W.T @ W
            self._bases.append(np.asarray(W))
            self._factors.append([_shifted(gram, a) for a in self.prior.amplitudes_mm])

    def quadratics(self, columns: FloatArray, residuals: FloatArray) -> list[Quadratic]:
        """Return the misfit with the field in the noise, for each length and amplitude.

        Parameters
        ----------
        columns : ndarray, shape (m, p)
            Whitened derivatives per prior standard deviation.
        residuals : ndarray, shape (m, n)
            Whitened.

        Returns
        -------
        list of Quadratic
            Amplitudes run fastest.
        """
        p = columns.shape[1]
        squares = (residuals**2).sum(axis=0)
        gradient, curvature = columns.T @ residuals, columns.T @ columns
        found = []
        for W, factors in zip(self._bases, self._factors, strict=True):
            projected = W.T @ np.hstack([columns, residuals])
            for amplitude, factor in zip(self.prior.amplitudes_mm, factors, strict=True):
                part = amplitude * solve_triangular(
                    factor, projected, lower=True, check_finite=False
                )
                A, rho = part[:, :p], part[:, p:]
                found.append(
                    Quadratic(
                        squares - (rho**2).sum(axis=0),
                        gradient - A.T @ rho,
                        curvature - A.T @ A,
                        2.0 * float(np.log(np.diag(factor)).sum()),
                    )
                )
        return found

    def log_evidences(self, at: Linearised, one_sided: BoolArray | None = None) -> FloatArray:
        """Return log evidence of a fit with the field added, shape (lengths, amplitudes).

        On the scale of `workers.diagnosis.evidence.log_evidence`.

        Parameters
        ----------
        at : Linearised
            With all parameters of the hypothesis as nominal ones.
        one_sided : ndarray of bool, shape (p,), optional

        Raises
        ------
        InputError
            If `at` has another number of residuals.
        """
        if at.size != self.size:
            raise InputError(
                f"The discrepancy was made for {self.size} residuals, the fit has {at.size}. "
                "Make one for its points."
            )
        if one_sided is None:
            one_sided = np.zeros(len(at.nominal_sd), dtype=bool)
        quadratics = self.quadratics(at.scaled_nominal, at.whitened_residual[:, None])
        found = [log_marginal(q, at.scaled_offset, one_sided)[0] for q in quadratics]
        return np.reshape(found, (len(self.prior.lengths_mm), len(self.prior.amplitudes_mm)))

    def log_evidence(self, at: Linearised, one_sided: BoolArray | None = None) -> float:
        """Return the average over lengths and amplitudes; see `log_evidences`."""
        found = self.log_evidences(at, one_sided)
        return float(logsumexp(found) - np.log(found.size))

    def ceiling(self, at: Linearised) -> Ceiling:
        """Return what the field of the largest evidence explains beyond the parameters of a fit.

        Both gaps are those of `workers.diagnosis.gap`: freed of the noise and of what
        fitting took of it.
        """
        found = self.log_evidences(at)
        length, amplitude = (int(i) for i in np.unravel_index(found.argmax(), found.shape))
        scale = self.prior.amplitudes_mm[amplitude]
        field = scale * (at.covariance_factor @ self._bases[length])
        free = at.freed(field, np.ones(field.shape[1]))
        without, along = LinearFit(at), LinearFit(free)
        share = float("nan")
        if without.excess_mm2 > 0:
            share = float(np.clip(1.0 - along.excess_mm2 / without.excess_mm2, 0.0, 1.0))
        weights = along.step[len(at.nominal_sd) :]
        return Ceiling(share, scale, self.prior.lengths_mm[length], np.asarray(-field @ weights))


def _pivoted(covariance: FloatArray, tolerance: float) -> FloatArray:
    """Return U, (m, rank), with ``U U'`` equal to the covariance but for a small diagonal."""
    factor, pivots, rank, _ = dpstrf(covariance, tol=tolerance, lower=1)
    U = np.empty((len(covariance), rank))
    U[pivots - 1] = np.tril(factor[:, :rank])
    return U


def _shifted(gram: FloatArray, amplitude: float) -> FloatArray:
    """Return the lower Cholesky factor of ``I + a^2 gram``."""
    return np.asarray(cholesky(np.eye(len(gram)) + amplitude**2 * gram, lower=True))

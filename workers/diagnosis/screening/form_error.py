"""How far a real effect's pattern may differ from that of the catalogue.

No real effect has just the form that is listed: friction has another law, a gradient another
shape. Where an effect changes the residuals by a pattern, it may in truth change them by a pattern
that is smoothly a fifth larger here and smaller there. The error is that of a displacement: it
moves both sides of a layer alike, so that one residual grows and the other one shrinks. As columns
with a prior these errors enter the evidence of the hypothesis: a strong effect then does not lose
to a field that mends its form, and does not beat a relative by some nats of hundreds; a weak one is
hardly touched. How large the error is, is not known: the evidence is averaged over that.

A cause that is not listed may resemble one that is. Its pattern then differs by more: the same
hypothesis with errors of form that are larger on the whole, in which the effects do not act.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.algebra.low_rank import pivoted
from palpate.workers.diagnosis.settings.values import SETTINGS


class FormError:
    """Errors of any pattern on the residuals' points.

    Parameters
    ----------
    points, normals : ndarray, shape (m, 3)
        At rest, of each residual.
    states : ndarray of int, shape (m,)
    state_correlation : ndarray, shape (s, s)
        Of each pair of states.
    field_length_mm : float
        The middle one of the smooth field that stands for something else.
    """

    def __init__(
        self,
        points: FloatArray,
        normals: FloatArray,
        states: IntArray,
        state_correlation: FloatArray,
        field_length_mm: float,
    ) -> None:
        settings = SETTINGS.form
        squares = cdist(points, points, "sqeuclidean")
        same = states[:, None] == states
        length_mm = settings.lengths * field_length_mm
        envelope_mm = settings.envelope_lengths * field_length_mm
        smooth = np.exp(-0.5 * squares / length_mm**2) * (normals @ normals.T)
        smooth *= state_correlation[np.ix_(states, states)]
        self._modes = pivoted(smooth, settings.rank_tolerance)
        near = np.exp(-0.5 * squares / envelope_mm**2) * same
        self._average = near / near.sum(axis=1)[:, None]

    def columns(self, pattern: FloatArray) -> FloatArray:
        """Return columns of unit deviation, for an error as large as the pattern, shape (m, k).

        Parameters
        ----------
        pattern : ndarray, shape (m,)
            What the effects of a hypothesis change of the residuals, once constants and poses
            have followed, in mm.
        """
        return self.envelope(pattern)[:, None] * self._modes

    def envelope(self, pattern: FloatArray) -> FloatArray:
        """Return the root mean square of a pattern around each point, shape (m,)."""
        return np.asarray(np.sqrt(self._average @ pattern**2))


def acting_or_alike(log_evidences: Sequence[float]) -> tuple[float, float]:
    """Return the log evidence of effects, whatever their error of form, and whether they act.

    Parameters
    ----------
    log_evidences : sequence of float
        With errors of each of ``SETTINGS.form.relative_sds``.

    Returns
    -------
    tuple of float
        Log evidence of effects that act or only resemble a cause that is not listed; and how
        probably they act.
    """
    settings = SETTINGS.form
    acts = np.log1p(-settings.likeness) + _averaged(log_evidences, settings.typical_sd)
    resemble = np.log(settings.likeness) + _averaged(log_evidences, settings.likeness_sd)
    either = np.logaddexp(acts, resemble)
    return float(either), float(np.exp(acts - either))


def log_prior_of_sizes() -> FloatArray:
    """Return that of each of ``SETTINGS.form.relative_sds``, whether the effects act or not."""
    settings = SETTINGS.form
    acts = (1.0 - settings.likeness) * _weights(settings.typical_sd)
    return np.asarray(np.log(acts + settings.likeness * _weights(settings.likeness_sd)))


def _averaged(log_evidences: Sequence[float], typical_sd: float) -> float:
    """Average over the size of the error, whose logarithm is normal about that of `typical_sd`."""
    return float(logsumexp(log_evidences, b=_weights(typical_sd)))


def _weights(typical_sd: float) -> FloatArray:
    settings = SETTINGS.form
    away = np.log(np.array(settings.relative_sds) / typical_sd) / settings.log_sd
    weights = np.exp(-0.5 * away**2)
    return np.asarray(weights / weights.sum())

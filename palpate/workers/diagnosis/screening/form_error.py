"""Form error: the difference between a real effect's pattern and its pattern in the catalogue.

No real effect has exactly the listed form: friction follows another law, a gradient has another
shape. The true pattern of changes in the residuals may be a fifth larger in one place and smaller
in another, varying smoothly. The error acts as a displacement: it moves both sides of a layer in
the same way, so that one residual grows and the other shrinks. These errors enter the evidence as
columns with a prior. A strong effect then neither loses to a field that corrects its form nor beats
a similar effect by a few nats out of hundreds; the evidence of a weak effect hardly changes. The
evidence is averaged over the unknown size of the error.

An unlisted cause may resemble a listed one, with larger differences in the pattern. It is modelled
as the same hypothesis with larger form errors, in which the effects do not act.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.algebra.low_rank import pivoted
from palpate.workers.diagnosis.settings.values import SETTINGS


class FormError:
    """Form error of any effect pattern at the points of the residuals.

    Parameters
    ----------
    points, normals : ndarray, shape (m, 3)
        Point at rest and normal of each residual.
    states : ndarray of int, shape (m,)
    state_correlation : ndarray, shape (s, s)
        Correlation of each pair of states.
    field_length_mm : float
        Middle correlation length of the smooth field for unlisted causes.
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
            Change in the residuals due to the effects of a hypothesis, after refitting constants
            and poses, in mm.
        """
        return self.envelope(pattern)[:, None] * self._modes

    def envelope(self, pattern: FloatArray) -> FloatArray:
        """Return the root mean square of a pattern around each point, shape (m,)."""
        return np.asarray(np.sqrt(self._average @ pattern**2))


def acting_or_alike(log_evidences: Sequence[float]) -> tuple[float, float]:
    """Return the log evidence averaged over form errors, and the probability that effects act.

    Parameters
    ----------
    log_evidences : sequence of float
        Log evidence for errors of each size in ``SETTINGS.form.relative_sds``.

    Returns
    -------
    tuple of float
        Log evidence of effects that act or only resemble an unlisted cause, and the probability
        that they act.
    """
    settings = SETTINGS.form
    acts = np.log1p(-settings.likeness) + _averaged(log_evidences, settings.typical_sd)
    resemble = np.log(settings.likeness) + _averaged(log_evidences, settings.likeness_sd)
    either = np.logaddexp(acts, resemble)
    return float(either), float(np.exp(acts - either))


def log_prior_of_sizes() -> FloatArray:
    """Return the log prior of ``SETTINGS.form.relative_sds``, whether or not the effects act."""
    settings = SETTINGS.form
    acts = (1.0 - settings.likeness) * _weights(settings.typical_sd)
    return np.asarray(np.log(acts + settings.likeness * _weights(settings.likeness_sd)))


def _averaged(log_evidences: Sequence[float], typical_sd: float) -> float:
    """Average over the size of the error, log-normal with median `typical_sd`."""
    return float(logsumexp(log_evidences, b=_weights(typical_sd)))


def _weights(typical_sd: float) -> FloatArray:
    settings = SETTINGS.form
    away = np.log(np.array(settings.relative_sds) / typical_sd) / settings.log_sd
    weights = np.exp(-0.5 * away**2)
    return np.asarray(weights / weights.sum())

"""How far a real effect's pattern may differ from that of the catalogue.

No real effect has just the form that is listed: friction has another law, a gradient another
shape. Where an effect changes the residuals by a pattern, it may in truth change them by a pattern
that is smoothly a fifth larger here and smaller there. The error is that of a displacement: it
moves both sides of a layer alike, so that one residual grows and the other one shrinks. As columns
with a prior these errors enter the evidence of the hypothesis: a strong effect then does not lose
to a field that mends its form, and does not beat a relative by some nats of hundreds; a weak one is
hardly touched.

A cause that is not listed may resemble one that is. Its pattern then differs by more: the same
hypothesis with a larger error of form, in which the effects do not act.
"""

import numpy as np
from scipy.spatial.distance import cdist

from storage.values import FloatArray, IntArray
from workers.diagnosis.low_rank import pivoted
from workers.diagnosis.settings import SETTINGS


class FormError:
    """Errors of any pattern on the residuals' points.

    Parameters
    ----------
    points, normals : ndarray, shape (m, 3)
        At rest, of each residual.
    states : ndarray of int, shape (m,)
    field_length_mm : float
        The middle one of the smooth field that stands for something else.
    """

    def __init__(
        self, points: FloatArray, normals: FloatArray, states: IntArray, field_length_mm: float
    ) -> None:
        settings = SETTINGS.form
        squares = cdist(points, points, "sqeuclidean")
        same = states[:, None] == states
        length_mm = settings.lengths * field_length_mm
        envelope_mm = settings.envelope_lengths * field_length_mm
        smooth = np.exp(-0.5 * squares / length_mm**2) * (normals @ normals.T)
        smooth *= np.where(same, 1.0, settings.state_correlation)
        self._modes = pivoted(smooth, settings.rank_tolerance)
        near = np.exp(-0.5 * squares / envelope_mm**2) * same
        self._average = near / near.sum(axis=1)[:, None]

    def columns(
        self, pattern: FloatArray, relative_sd: float = SETTINGS.form.relative_sd
    ) -> FloatArray:
        """Return columns of unit deviation, shape (m, k).

        Parameters
        ----------
        pattern : ndarray, shape (m,)
            What the effects of a hypothesis change of the residuals, once constants and poses
            have followed, in mm.
        relative_sd : float
            Standard deviation of the error, over the size of the pattern.
        """
        return relative_sd * self.envelope(pattern)[:, None] * self._modes

    def envelope(self, pattern: FloatArray) -> FloatArray:
        """Return the root mean square of a pattern around each point, shape (m,)."""
        return np.asarray(np.sqrt(self._average @ pattern**2))

"""Model errors that every hypothesis allows for: held constants, rough surface, effect forms.

**Held constants.** Every hypothesis holds Poisson's ratio at the value given in the case. A value
of 0.490 has three digits, so the changes due to +-0.002 belong to the noise of all hypotheses. The
effect in the catalogue that changes the ratio is far larger.

**Rough surface.** The mesh is made from a smoothed segmented interface at rest and retains some of
its error, while the body is smooth. Bodies without a skin therefore appear to have a slight one,
with a stiffness nearly always above zero, due both to noise alone and to the model's true error.
The likely reason for the former is that tension flattens bumps, and the residuals contain the same
bumps, because they start from the scan at rest. Such a bias grows with the square of the roughness;
this is assumed here, not measured. Every hypothesis includes the observed bias with its scatter.

**Form error** is the difference between a real effect's pattern and its pattern in the catalogue.
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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.noise.averaged_evidence import LinearHypothesis
from palpate.workers.diagnosis.noise.noise_components import pivoted


def held_columns(sensitivities: Iterable[EffectSensitivity], residuals: int) -> FloatArray:
    """Return the change due to one standard deviation of each held constant, (m, q), in mm.

    Parameters
    ----------
    sensitivities : iterable of EffectSensitivity
        Sensitivities; those without a `held_sd` are ignored.
    residuals : int
        Number m of residuals.
    """
    held = [one.places[0] * np.array(one.held_sd) for one in sensitivities if one.held_sd]
    return np.hstack([np.zeros((residuals, 0)), *held])


@dataclass(frozen=True, eq=False)
class RoughSurface:
    """Residuals that resemble the effect of a skin.

    Parameters
    ----------
    expected : ndarray, shape (m,)
        Expected bias in mm.
    column : ndarray, shape (m, 1)
        One standard deviation of the bias.
    """

    expected: FloatArray
    column: FloatArray

    @staticmethod
    def like(skin: EffectSensitivity, drawn_sd_mm: float) -> "RoughSurface":
        """Return the bias for a scan at rest whose outline has an error of the given size.

        Parameters
        ----------
        skin : EffectSensitivity
            Sensitivity to a skin's stiffness per width, in N/mm; the smallest magnitude tried is
            used.
        drawn_sd_mm : float
        """
        settings = SETTINGS.noise
        of_skin = skin.places[-1][:, :1]
        squares = (drawn_sd_mm / settings.rough_at_mm) ** 2
        return RoughSurface(
            np.asarray(-settings.rough_skin_n_per_mm * squares * of_skin[:, 0]),
            np.asarray(settings.rough_skin_sd_n_per_mm * squares * of_skin),
        )

    def taken_off(self, at: LinearHypothesis) -> LinearHypothesis:
        """Return a hypothesis with the expected bias subtracted and its uncertainty added."""
        return replace(at, residual=at.residual - self.expected).with_errors(self.column)


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

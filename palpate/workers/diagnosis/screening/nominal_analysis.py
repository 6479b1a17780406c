"""The nominal model at its optimum, with the sensitivities of all effects.

This is the state before any effect is fitted. Quantities needed only by some tasks, such as the
smooth field, are computed on first use.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit
from palpate.workers.diagnosis.noise.evidence import LinearHypothesis, NoiseModel
from palpate.workers.diagnosis.noise.nuisances import smooth_columns
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.places import places_of
from palpate.workers.diagnosis.screening.form_error import FormError
from palpate.workers.diagnosis.screening.held_constants import held_columns
from palpate.workers.diagnosis.screening.rough_surface import RoughSurface
from palpate.workers.diagnosis.screening.screening import ScreeningResult, screen
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.base import Effect


@dataclass(frozen=True, eq=False)
class NominalAnalysis:
    """The nominal fit with the sensitivities of all effects.

    Parameters
    ----------
    inverse : InverseProblem
        Problem with the points and the noise of the calibration.
    nominal : SolvedFit
        Fit of the constants alone.
    sensitivities : sequence of EffectSensitivity
        Sensitivities to the effects that act on at least one scan and could be simulated.
    begun : mapping of str to mapping
        Starting values by name of the effect: constants and parameters of single effects that were
        fitted with an earlier estimate of the noise.
    """

    inverse: InverseProblem
    nominal: SolvedFit
    sensitivities: Sequence[EffectSensitivity]
    begun: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @cached_property
    def linear(self) -> Linearised:
        """Residuals, derivatives and noise around the nominal fit."""
        return self.nominal.linearised(self.inverse)

    @cached_property
    def linear_with_poses(self) -> Linearised:
        """Residuals, derivatives and noise with poses and contour bias as free parameters."""
        return self.nominal.linearised_with_poses(self.inverse)

    @cached_property
    def screening(self) -> tuple[ScreeningResult, ...]:
        """Screening results of single effects, the largest Bayes factor first."""
        return screen(self.linear, self.sensitivities)

    def places(self, effect: Effect) -> FloatArray:
        """Return the places at which an effect was evaluated; see `places_of`."""
        return places_of(self.inverse, effect)

    def is_steep(self, effect: Effect) -> bool:
        """Return True if the response to an effect grows faster than its magnitude.

        The linear model then underestimates a large effect.
        """
        return effect.place is None and self.sensitivity_by_name[effect.name].is_steep

    @cached_property
    def noise(self) -> NoiseModel:
        """Noise of the evidence of all hypotheses, with the smooth field for unlisted causes.

        It takes seconds for 4,000 residuals.
        """
        learnt, prior = self.inverse.learnt, self.inverse.something_else
        if learnt is None:
            raise ValueError("the noise is only known after the calibration")
        return NoiseModel(learnt.parts, learnt.states, self.fields, prior.amplitudes_mm)

    @cached_property
    def coarse_noise(self) -> NoiseModel:
        """Noise of the posterior of parameters and gaps; see `workers.diagnosis.noise.evidence`."""
        return self.noise.coarsened(self.inverse.coarsening)

    def hypothesis(self, at: Fit) -> LinearHypothesis:
        """Return a fit as input for `noise`, corrected for the roughness of the drawn surface.

        The uncertainty of constants that are held fixed is included.
        """
        found = at.hypothesis(self.inverse).with_errors(self._held)
        return found if self._rough is None else self._rough.taken_off(found)

    @cached_property
    def _held(self) -> FloatArray:
        """Columns of held constants; empty for markers, as uncertain constants are then fitted."""
        m = len(self.inverse.bias)
        return held_columns(self.sensitivities if self.inverse.is_segmented else (), m)

    @cached_property
    def _rough(self) -> RoughSurface | None:
        """Bias from roughness; None if no effect resembles it, or there is no drawing error."""
        skin = next((one for one in self.sensitivities if one.resembles_roughness), None)
        drawn_sd_mm, learnt = self.inverse.noise.reference_sd_mm, self.inverse.learnt
        if skin is None or learnt is None or not (self.inverse.is_segmented and drawn_sd_mm):
            return None
        return RoughSurface.like(skin, drawn_sd_mm * float(learnt.states[0].scales[0]))

    def registered(self, change: FloatArray) -> FloatArray:
        """Return a change of the residuals, (m,), without the part that the nuisances absorb."""
        poses = self.nominal.pose_columns(self.inverse)
        nuisances = np.hstack([poses, self.inverse.drawing])
        white = self.linear.whiten(np.column_stack([nuisances, change]))
        return np.asarray(change - nuisances @ (white[:, :-1].T @ white[:, -1]))

    @cached_property
    def fields(self) -> tuple[FloatArray, ...]:
        """Columns of a smooth field of unit amplitude, (m, r) in mm, for each length."""
        lengths = self.inverse.something_else.lengths_mm
        return tuple(self._smooth_columns(length) for length in lengths)

    @property
    def field(self) -> FloatArray:
        """Columns of a smooth field of medium amplitude and length, shape (m, r), in mm."""
        prior = self.inverse.something_else
        return prior.middle_amplitude_mm * self._smooth_columns(prior.middle_length_mm)

    def _smooth_columns(self, length_mm: float) -> FloatArray:
        normals = np.concatenate([scan.normals for scan in self.nominal.predictions])
        return smooth_columns(
            self._points,
            normals,
            self.inverse.rows,
            np.ones(len(normals)),
            length_mm,
            self.inverse.something_else.state_correlation.between(self.inverse.directions),
            SETTINGS.smooth_field.rank_tolerance,
        )

    @cached_property
    def form(self) -> FormError:
        """Form errors of the catalogue's patterns."""
        inverse = self.inverse
        normals = np.tile(inverse.points.normals, (len(inverse.scans), 1))
        length_mm = inverse.something_else.middle_length_mm
        between = SETTINGS.form.state_correlation.between(inverse.directions)
        return FormError(self._points, normals, inverse.rows, between, length_mm)

    def errors_of_form(self, at: LinearHypothesis) -> FloatArray:
        """Return columns of unit deviation for form errors as large as the effects' change."""
        changed = self.hypothesis(self.nominal).residual - at.residual
        return self.form.columns(self.registered(changed))

    @property
    def _points(self) -> FloatArray:
        return np.tile(self.inverse.points.points, (len(self.inverse.scans), 1))

    @property
    def sensitivity_by_name(self) -> dict[str, EffectSensitivity]:
        """Sensitivities by name of the effect."""
        return {one.name: one for one in self.sensitivities}

    @property
    def screening_by_name(self) -> dict[str, ScreeningResult]:
        """Results of the screening by name of the effect."""
        return {one.name: one for one in self.screening}

    @property
    def hidden(self) -> set[str]:
        """Effects that the constants hide."""
        return {one.name for one in self.screening if one.hides}

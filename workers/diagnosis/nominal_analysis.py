"""The nominal model at its optimum, and what every effect would do to its residuals.

All that is known before any effect is fitted. What only a part of the tasks needs, such as the
smooth field, is computed when it is first asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from workers.diagnosis.discrepancy import Discrepancy
from workers.diagnosis.effect_sensitivity import EffectSensitivity
from workers.diagnosis.gauss_newton import SolvedFit
from workers.diagnosis.inverse_problem import InverseProblem
from workers.diagnosis.linearisation import Linearised
from workers.diagnosis.screening import ScreeningResult, screen
from workers.diagnosis.sensitivity_analysis import InclusionGrid, inclusion_grid


@dataclass(frozen=True, eq=False)
class NominalAnalysis:
    """The nominal fit with the sensitivities of all effects.

    Parameters
    ----------
    inverse : InverseProblem
        With the points and the noise of the calibration.
    nominal : SolvedFit
        Of the constants alone.
    sensitivities : sequence of EffectSensitivity
        Of the effects that act on some scan and could be simulated.
    """

    inverse: InverseProblem
    nominal: SolvedFit
    sensitivities: Sequence[EffectSensitivity]

    @cached_property
    def linear(self) -> Linearised:
        """Residuals, derivatives and noise around the nominal fit."""
        return self.nominal.linearised(self.inverse)

    @cached_property
    def screening(self) -> tuple[ScreeningResult, ...]:
        """Every effect on its own in the linear model, the largest Bayes factor first."""
        return screen(self.linear, self.sensitivities)

    @cached_property
    def inclusion_grid(self) -> InclusionGrid:
        """Places at which a lump was looked for."""
        return inclusion_grid(self.inverse)

    @cached_property
    def field(self) -> Discrepancy:
        """The smooth field that stands for something else; seconds for 4,000 residuals."""
        normals = np.concatenate([scan.normals for scan in self.nominal.predictions])
        points = np.tile(self.inverse.points.points, (len(self.inverse.scans), 1))
        inverse = self.inverse
        at = points, normals, inverse.rows, inverse.covariance_factor
        return Discrepancy(*at, inverse.something_else)

    @property
    def sensitivity_by_name(self) -> dict[str, EffectSensitivity]:
        """Sensitivities by the name of the effect."""
        return {one.name: one for one in self.sensitivities}

    @property
    def screening_by_name(self) -> dict[str, ScreeningResult]:
        """Results of the screening by the name of the effect."""
        return {one.name: one for one in self.screening}

    @property
    def hidden(self) -> set[str]:
        """Effects that the constants hide."""
        return {one.name for one in self.screening if one.hides}

"""What a mesh lacks at its surface that is as rough as the scan at rest was drawn.

The mesh is made of a drawn interface, smoothed, but not free of the error with which it was drawn;
the body is smooth. Bodies that have no skin are found to have a little one, nearly always above
zero: of the noise alone as well as of the model's true error. What explains the first is that
tension pulls bumps flat, and the residuals have the same bumps in them, since they begin at the
scan at rest; such a bias grows with the square of the roughness, which is assumed here and was not
measured. Every hypothesis has as much of it as was found, give or take what that scatters.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.noise.evidence import LinearHypothesis
from palpate.workers.diagnosis.settings.values import SETTINGS


@dataclass(frozen=True, eq=False)
class RoughSurface:
    """Residuals that look like a skin.

    Parameters
    ----------
    expected : ndarray, shape (m,)
        In mm.
    column : ndarray, shape (m, 1)
        One standard deviation of it.
    """

    expected: FloatArray
    column: FloatArray

    @staticmethod
    def like(skin: EffectSensitivity, drawn_sd_mm: float) -> "RoughSurface":
        """Return that of a scan at rest whose outline was drawn with this error.

        Parameters
        ----------
        skin : EffectSensitivity
            Of a stiffness per width, in N/mm; the least magnitude that was tried counts.
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
        """Return a hypothesis whose residuals are less by it, as far as it is known."""
        return replace(at, residual=at.residual - self.expected).with_errors(self.column)

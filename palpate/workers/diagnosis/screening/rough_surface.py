"""Bias due to the roughness of the mesh surface, inherited from the segmentation at rest.

The mesh is made from a smoothed segmented interface and retains some of its error, while the body
is smooth. Bodies without a skin therefore appear to have a slight one, with a stiffness nearly
always above zero, due both to noise alone and to the model's true error. The likely reason for the
former is that tension flattens bumps, and the residuals contain the same bumps, because they start
from the scan at rest. Such a bias grows with the square of the roughness; this is assumed here, not
measured. Every hypothesis includes the observed bias with its scatter.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.noise.evidence import LinearHypothesis
from palpate.workers.diagnosis.settings.values import SETTINGS


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

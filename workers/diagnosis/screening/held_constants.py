"""Uncertainty of constants that are held fixed.

Every hypothesis holds Poisson's ratio at the value stated in the case. A stated 0.490 has three
digits, so the changes due to +-0.002 belong to the noise of all hypotheses. The catalogue's effect
that changes it is far larger.
"""

from collections.abc import Iterable

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity


def held_columns(sensitivities: Iterable[EffectSensitivity], residuals: int) -> FloatArray:
    """Return the change by one standard deviation of each held constant, shape (m, q), in mm.

    Parameters
    ----------
    sensitivities : iterable of EffectSensitivity
        Those without a `held_sd` are ignored.
    residuals : int
        Number m of residuals.
    """
    held = [one.places[0] * np.array(one.held_sd) for one in sensitivities if one.held_sd]
    return np.hstack([np.zeros((residuals, 0)), *held])

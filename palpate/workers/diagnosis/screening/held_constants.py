"""Uncertainty of constants that are held fixed.

Every hypothesis holds Poisson's ratio at the value given in the case. A value of 0.490 has three
digits, so the changes due to +-0.002 belong to the noise of all hypotheses. The effect in the
catalogue that changes the ratio is far larger.
"""

from collections.abc import Iterable

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity


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

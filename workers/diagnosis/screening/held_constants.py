"""A constant that the model holds is not known exactly.

A case states Poisson's ratio, and every hypothesis holds it. A stated 0.490 is a number with three
digits: what 0.002 more or less do to the residuals belongs to the noise of all hypotheses. The
effect of the catalogue that changes it is far larger.
"""

from collections.abc import Mapping

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.material import COMPRESSIBILITY


def held_columns(sensitivities: Mapping[str, EffectSensitivity], residuals: int) -> FloatArray:
    """Return what one standard deviation of the held constant does, shape (m, q), in mm.

    Parameters
    ----------
    sensitivities : mapping of str to EffectSensitivity
        By the name of the effect. What is not among them is not held, or cannot be simulated.
    residuals : int
        Their number m.
    """
    found = sensitivities.get(COMPRESSIBILITY.name)
    if found is None:
        return np.zeros((residuals, 0))
    return np.asarray(found.places[0] * SETTINGS.noise.held_log_compressibility)

"""A constant that the model holds is not known exactly.

A case states Poisson's ratio, and every hypothesis holds it. A stated 0.490 is a number with three
digits: what 0.002 more or less do to the residuals belongs to the noise of all hypotheses. The
effect of the catalogue that changes it is far larger.
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
        Those without a `held_sd` are left out.
    residuals : int
        Their number m.
    """
    held = [one.places[0] * np.array(one.held_sd) for one in sensitivities if one.held_sd]
    return np.hstack([np.zeros((residuals, 0)), *held])

"""How much evidence against "no gap" noise alone produces.

The posterior probability assumes that the noise is just as stated. The threshold of the
alarm is set on replicates without any effect instead: those of the linear model below, and
bodies of another solver, which give the least threshold (`workers.diagnosis.diagnosis`).
"""

from collections.abc import Sequence

import numpy as np

from storage.errors import InputError
from storage.values import FloatArray
from workers.diagnosis.discrepancy import Discrepancy
from workers.diagnosis.effect_sensitivity import EffectSensitivity
from workers.diagnosis.joint_evidence import JointEvidence
from workers.diagnosis.linearisation import Linearised
from workers.diagnosis.settings import SETTINGS


def null_alarms(
    problem: Linearised,
    sensitivities: Sequence[EffectSensitivity],
    seed: int,
    draws: int = SETTINGS.alarm.replicates,
    discrepancy: Discrepancy | None = None,
) -> FloatArray:
    """Return alarms of replicates without an effect; see `workers.diagnosis.hypotheses.alarm`.

    Parameters, from their prior, and noise are drawn, and all hypotheses are weighed anew.

    Parameters
    ----------
    problem : Linearised
        Its residual is not looked at.
    sensitivities : sequence of EffectSensitivity
        All that the diagnosis looks for.
    seed : int
        The same seed gives the same replicates.
    draws : int
    discrepancy : Discrepancy, optional
        Where the diagnosis tries a smooth field.

    Returns
    -------
    ndarray, shape (draws,)
        In nats, unsorted.
    """
    rng = np.random.default_rng(seed)
    parameters = rng.standard_normal((len(problem.nominal_sd), draws))
    replicates = rng.standard_normal((problem.size, draws)) - problem.scaled_nominal @ parameters
    joint = JointEvidence(problem, sensitivities, discrepancy, replicates)
    found = [_best(joint, (name,)) for name in joint.names]
    nothing = joint.log_evidence(())
    return np.asarray(np.max([*found, _best(joint, ())], axis=0) - nothing)


def alarm_threshold(alarms: FloatArray, rate: float = SETTINGS.alarm.false_alarm_rate) -> float:
    """Return the alarm that a case without effect exceeds with probability `rate` at most.

    An order statistic: over replicates and a case of the same kind the rate holds on
    average, whatever their distribution. Never below zero: an alternative less probable
    than no gap is no reason for an alarm.

    Parameters
    ----------
    alarms : ndarray, shape (n,)
        Of replicates without an effect, in nats.
    rate : float
        0 to 1; n must be large enough for four replicates to lie above.

    Raises
    ------
    InputError
        If there are too few replicates, or an alarm is not a number.
    """
    n = len(alarms)
    if not 0 < rate < 1 or np.isnan(alarms).any() or n * rate < 4 - 1e-9:
        needed = int(np.ceil(4 / rate)) if 0 < rate < 1 else "4 / rate"
        raise InputError(
            f"A threshold for a false alarm rate of {rate} needs {needed} or more replicates, "
            f"none of them nan, and a rate between 0 and 1; found {n} replicates."
        )
    rank = min(n, int(np.ceil((1 - rate) * (n + 1))))
    return max(0.0, float(np.sort(alarms)[rank - 1]))


def _best(joint: JointEvidence, effects: tuple[str, ...]) -> FloatArray:
    gain = joint.discrepancy_gain(effects)
    plain = joint.log_evidence(effects)
    return plain if gain is None else plain + np.maximum(gain, 0.0)

"""The alarm on cases without an effect."""

from dataclasses import replace

import numpy as np
import pytest
from linear_world import catalogue, hypotheses_of, nominal_problem, observed, smooth_field

from storage.errors import InputError
from workers.diagnosis.alarm_threshold import alarm_threshold, null_alarms
from workers.diagnosis.hypotheses import alarm
from workers.diagnosis.joint_evidence import JointEvidence


def test_replicates_are_alarms_of_single_cases():
    """One replicate's number equals that of the chain for one case."""
    problem = nominal_problem()
    rng = np.random.default_rng(9)
    z, n = rng.standard_normal((3, 5)), rng.standard_normal((problem.size, 5))
    found = null_alarms(problem, catalogue(), 9, 5, smooth_field())
    for i in range(5):
        r = problem.covariance_factor @ n[:, i] - problem.nominal @ (problem.nominal_sd * z[:, i])
        joint = JointEvidence(replace(problem, residual=r), catalogue(), smooth_field())
        assert found[i] == pytest.approx(alarm(hypotheses_of(joint, partners=0)), abs=1e-8)


@pytest.mark.parametrize("field", [None, smooth_field()], ids=["effects", "and a field"])
def test_false_alarms_come_at_the_wanted_rate(field):
    """Threshold from 1,000 replicates at 5 %, counted on 2,000 others: within 3 errors."""
    problem = nominal_problem()
    threshold = alarm_threshold(null_alarms(problem, catalogue(), 1, 1000, field), 0.05)
    others = null_alarms(problem, catalogue(), 2, 2000, field)
    error = np.sqrt(0.05 * 0.95 * (1 / 1000 + 1 / 2000))
    assert np.mean(others > threshold) == pytest.approx(0.05, abs=3 * error)
    assert threshold > 0


def test_rate_holds_on_average_over_small_sets():
    """200 replicates at 2 %: over many sets the mean rate is 4 / 201 at most."""
    rng = np.random.default_rng(3)
    rates = [
        np.exp(-alarm_threshold(rng.exponential(size=200), 0.02)) for _ in range(4000)
    ]  # exceeding t has probability e^-t
    assert np.mean(rates) == pytest.approx(4 / 201, abs=4 * np.std(rates) / np.sqrt(4000))


def test_a_strong_effect_raises_the_alarm():
    problem = nominal_problem()
    threshold = alarm_threshold(null_alarms(problem, catalogue(), 1, 400), 0.02)
    loud = observed(problem, np.random.default_rng(4), -catalogue()[1].columns[:, 0])
    assert alarm(hypotheses_of(JointEvidence(loud, catalogue()))) > threshold + 5


def test_same_seed_same_replicates():
    first, again, other = (null_alarms(nominal_problem(), catalogue(), s, 20) for s in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def test_the_threshold_is_never_negative():
    assert alarm_threshold(np.full(100, -3.0), 0.1) == 0.0


def test_too_few_replicates():
    with pytest.raises(InputError, match="needs 200 or more replicates"):
        alarm_threshold(np.zeros(199), 0.02)
    assert alarm_threshold(np.ones(200), 0.02) == 1.0
    with pytest.raises(InputError, match="none of them nan"):
        alarm_threshold(np.full(500, np.nan), 0.02)

"""The two stall rules against sums calculated by hand."""

import numpy as np
import pytest

from palpate.service.search.stop_rules import Stall, StallRule
from palpate.storage.errors import InputError


def change(rule: StallRule, bests: list[float], window: int, tolerance: float) -> bool:
    """Return True if the rule stops the search."""
    stall = Stall(generations=window, tolerance=tolerance, rule=rule)
    return stall.reason(np.array(bests)) is not None


# Each row: best scores, window, the average change calculated by hand.
RELATIVE = [
    # |10 - 4| / (3 * max(1, 4)) = 0.5
    ([10, 8, 6, 4], 3, 0.5),
    # only the last three steps count: |8 - 4| / (2 * 4) = 0.5
    ([100, 8, 6, 4], 2, 0.5),
    # below one the change is absolute: |0.5 - 0.25| / (2 * 1) = 0.125
    ([0.5, 0.5, 0.25], 2, 0.125),
    # logarithms are negative: |-2 - (-4)| / (2 * 4) = 0.25
    ([-2, -4, -4], 2, 0.25),
]
WEIGHTED = [
    # newest first: 2/4, 2/6, 2/8; weights 1, 1/2, 1/4: (1/2 + 1/6 + 1/16) / (7/4) = 5/12
    ([10, 8, 6, 4], 3, 5 / 12),
    # the same total improvement, all of it long ago: (0 + 0 + (1/4) 6/4) / (7/4) = 3/14
    ([10, 4, 4, 4], 3, 3 / 14),
    # and all of it just now: (6/4) / (7/4) = 6/7
    ([10, 10, 10, 4], 3, 6 / 7),
    # -1 to -4: 3/4 now; weights 1, 1/2: (3/4) / (3/2) = 1/2
    ([-1, -1, -4], 2, 1 / 2),
]


@pytest.mark.parametrize(("bests", "window", "average"), RELATIVE)
def test_relative_rule_matches_hand_calculation(
    bests: list[float], window: int, average: float
) -> None:
    assert change("relative", bests, window, average * 1.000001)
    assert not change("relative", bests, window, average * 0.999999)


@pytest.mark.parametrize(("bests", "window", "average"), WEIGHTED)
def test_weighted_rule_matches_hand_calculation(
    bests: list[float], window: int, average: float
) -> None:
    assert change("weighted", bests, window, average * 1.000001)
    assert not change("weighted", bests, window, average * 0.999999)


@pytest.mark.parametrize("rule", ["relative", "weighted"])
def test_stall_needs_five_steps_without_change(rule: StallRule) -> None:
    stall = Stall(rule=rule)
    assert stall.reason(np.full(5, -3.0)) is None  # five generations are four steps
    reason = stall.reason(np.full(6, -3.0))
    assert reason is not None
    assert "stalled" in reason
    assert stall.reason(np.array([-2.9, *[-3.0] * 5])) is None
    assert stall.reason(np.array([-2.9, *[-3.0] * 6])) is not None


def test_weighted_rule_forgets_an_old_step_and_relative_does_not() -> None:
    bests = [-1.0, -1.0001, -1.0001, -1.0001, -1.0001, -1.0001]
    # relative: 1e-4 / 5 = 2e-5; weighted: (1/16) 1e-4 / (31/16) = 3.2e-6
    assert not change("relative", bests, 5, 1e-5)
    assert change("weighted", bests, 5, 1e-5)


@pytest.mark.parametrize("rule", ["relative", "weighted"])
def test_infinite_scores_are_never_subtracted(rule: StallRule) -> None:
    stall = Stall(generations=2, tolerance=1e300, rule=rule)
    inf = np.inf
    # The step from failure to success is the largest there is.
    assert stall.reason(np.array([inf, inf, 3.0])) is None
    assert stall.reason(np.array([inf, 3.0, 3.0])) is None
    assert stall.reason(np.array([inf, 3.0, 3.0, 3.0])) is not None
    assert stall.reason(np.array([3.0, 3.0, -inf])) is None
    assert stall.reason(np.array([-inf, -inf, -inf])) is None


def test_a_search_without_any_success_stops_with_its_own_reason() -> None:
    stall = Stall(generations=2)
    assert stall.reason(np.full(2, np.inf)) is None
    reason = stall.reason(np.full(3, np.inf))
    assert reason is not None
    assert "no simulation has succeeded in 3 generations" in reason


def test_zero_tolerance_stops_only_without_any_change() -> None:
    assert change("relative", [-3.0, -3.0, -3.0], 2, 0.0)
    assert not change("relative", [-3.0, -3.0, np.nextafter(-3.0, -4.0)], 2, 0.0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"generations": 0}, r"stall\.generations"),
        ({"tolerance": -1e-6}, r"stall\.tolerance"),
        ({"tolerance": float("nan")}, r"stall\.tolerance"),
        ({"rule": "absolute"}, r"stall\.rule must be one of relative, weighted, got 'absolute'"),
    ],
)
def test_rejects_invalid_settings(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Stall(**wrong)  # type: ignore[arg-type]

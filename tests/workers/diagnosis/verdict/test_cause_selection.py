"""The rule that names causes, case by case, and its independence of the order of the fits."""

from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.verdict.cause_selection import selected, verdict

FIRST, FURTHER = SETTINGS.selection.first, SETTINGS.selection.further
TIE, LEFT = SETTINGS.selection.tie, SETTINGS.selection.left
MORE = 0.01
A, B, C = ("a",), ("b",), ("c",)
AB, BA, ABC = ("a", "b"), ("b", "a"), ("b", "c", "a")


class Case(NamedTuple):
    """Gains of fits and of a field beside them, with the expected verdict."""

    gains: dict[tuple[str, ...], float]
    kind: str
    primary: str = ""
    rivals: str = ""
    left: float = 0.0
    hidden: str = ""


CASES = {
    "nothing was fitted": Case({}, "no-gap"),
    "nothing gains": Case({A: -3.0, B: 0.0}, "no-gap", left=-1.0),
    "the least gain is not enough": Case({A: FIRST}, "no-gap"),
    "more than the least gain": Case({A: FIRST + MORE}, "effect", "a"),
    "the least gain of a field alone": Case({A: FIRST}, "no-gap", left=LEFT),
    "a field alone": Case({A: FIRST}, "none-of-these", left=LEFT + MORE),
    "a field without any fit": Case({}, "none-of-these", left=99.0),
    "a field beside an effect": Case({A: 50.0}, "effect", "a", left=49.0),
    "a field as large as an effect": Case({A: 50.0}, "effect", "a", left=50.0),
    "a field larger than an effect": Case({A: 50.0}, "none-of-these", left=50.0 + MORE),
    "a rival at the limit": Case({A: 50.0, B: 50.0 - TIE}, "effect", "a"),
    "a rival": Case({A: 50.0 - TIE + MORE, B: 50.0}, "cannot-be-told-apart", "b", "b a"),
    "equal rivals": Case({B: 50.0, A: 50.0}, "cannot-be-told-apart", "a", "a b"),
    "three rivals": Case({C: 48.0, B: 49.0, A: 50.0}, "cannot-be-told-apart", "a", "a b c"),
    "a field larger than rivals": Case({A: 50.0, B: 50.0}, "none-of-these", left=51.0),
    "a pair that adds too little": Case({A: 50.0, AB: 50.0 + FURTHER}, "effect", "a"),
    "a pair": Case({A: 50.0, AB: 50.0 + FURTHER + MORE}, "effect", "a b"),
    "a pair of rivals": Case({A: 50.0, B: 49.0, AB: 90.0}, "effect", "a b"),
    "a pair that leaves rivals": Case(
        {A: 50.0, B: 49.0, AB: 64.0}, "cannot-be-told-apart", "a", "a b"
    ),
    "the stronger of a pair is first": Case({A: 40.0, B: 50.0, AB: 90.0}, "effect", "b a"),
    "a pair in another order": Case({A: 50.0, BA: 90.0}, "effect", "a b"),
    "a pair in both orders": Case({A: 50.0, AB: 55.0, BA: 90.0}, "effect", "a b", left=80.0),
    "a field larger than a pair": Case({A: 50.0, AB: 90.0}, "none-of-these", left=91.0),
    "a field larger than the first of a pair": Case(
        {A: 50.0, AB: 90.0}, "effect", "a b", left=70.0
    ),
    "a pair without the best effect": Case({A: 50.0, B: 40.0, ("b", "c"): 99.0}, "effect", "a"),
    "a triple that adds too little": Case(
        {A: 50.0, AB: 90.0, ABC: 90.0 + FURTHER}, "effect", "a b"
    ),
    "a triple": Case({A: 50.0, AB: 90.0, ABC: 90.0 + FURTHER + MORE}, "effect", "a b c"),
    "a triple without its pair": Case({A: 50.0, ABC: 120.0}, "effect", "a"),
    "the best of two pairs": Case(
        {A: 50.0, AB: 90.0, ("c", "a"): 95.0, ABC: 140.0}, "effect", "a c b"
    ),
    "a hidden effect gains most": Case({A: 20.0, B: 60.0}, "effect", "a", hidden="b"),
    "a hidden effect is no rival": Case({A: 20.0, B: 19.0}, "effect", "a", hidden="b"),
    "a hidden effect is no partner": Case({A: 20.0, AB: 90.0}, "effect", "a", hidden="b"),
    "only a hidden effect gains": Case({A: 3.0, B: 60.0}, "no-gap", hidden="b"),
    "a field and a hidden effect": Case({B: 60.0}, "none-of-these", left=LEFT + MORE, hidden="b"),
}


@pytest.mark.parametrize("case", CASES)
def test_names_causes(case: str) -> None:
    gains, kind, primary, rivals, left, hidden = CASES[case]
    found = verdict(gains, left, hidden.split())
    assert (found.kind, found.primary) == (kind, tuple(primary.split()))
    assert found.rivals == tuple(rivals.split())
    assert found.hidden == tuple(hidden.split())
    assert found.left_gain == left


def test_gain_is_that_of_the_best_visible_effect() -> None:
    assert verdict({A: 50.0, B: 20.0, AB: 90.0}, 0.0).gain == 50.0
    assert verdict({A: 50.0, B: 20.0}, 0.0, {"a"}).gain == 20.0
    assert verdict({A: -3.0}, 0.0).gain == 0.0
    assert verdict({A: 3.0}, 99.0).gain == 3.0


def test_something_else_acts_if_a_field_gains_beside_the_effects() -> None:
    assert not verdict({A: 50.0}, LEFT).something_else_acts
    assert verdict({A: 50.0}, LEFT + MORE).something_else_acts


def test_no_fourth_effect_is_selected() -> None:
    gains = {("a",): 50.0, ("a", "b"): 90.0, ("a", "b", "c"): 130.0, ("a", "b", "c", "d"): 200.0}
    assert selected(gains) == ("a", "b", "c")


@pytest.mark.parametrize("effects", [(), ("a", "a"), ("a", "b", "c", "d")])
def test_rejects_impossible_combinations(effects: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="one to 3 different effects"):
        verdict({A: 1.0, effects: 2.0}, 0.0)


names = st.lists(st.sampled_from("abcde"), min_size=1, max_size=3, unique=True).map(tuple)
# Few different values, so that gains are often equal.
nats = st.integers(-1, 12).map(lambda n: 8.0 * n)
tables: Any = st.dictionaries(names, nats, max_size=24)


@given(tables, nats, st.sets(st.sampled_from("abcde"), max_size=2), st.randoms())
def test_naming_does_not_depend_on_the_order_of_the_fits(
    gains: dict[tuple[str, ...], float], left: float, hidden: set[str], random: Any
) -> None:
    shuffled = list(gains.items())
    random.shuffle(shuffled)
    assert verdict(dict(shuffled), left, hidden) == verdict(gains, left, hidden)


@given(tables, nats, st.sets(st.sampled_from("abcde"), max_size=2))
def test_every_named_effect_adds_enough(
    gains: dict[tuple[str, ...], float], left: float, hidden: set[str]
) -> None:
    found = verdict(gains, left, hidden)
    best: dict[frozenset[str], float] = {}
    for who, gain in gains.items():
        best[frozenset(who)] = max(gain, best.get(frozenset(who), gain))
    before = 0.0
    for count in range(1, len(found.primary) + 1):
        now = best[frozenset(found.primary[:count])]
        assert now - before > (FIRST if count == 1 else FURTHER)
        before = now
    assert not set(found.primary) & hidden
    assert bool(found.primary) == (found.kind in ("effect", "cannot-be-told-apart"))
    assert bool(found.rivals) == (found.kind == "cannot-be-told-apart")
    if found.primary:
        assert left <= before


def test_a_further_cause_of_measured_points_needs_less() -> None:
    gains = {("a",): 450.0, ("a", "b"): 461.2}
    assert selected(gains) == ("a",)
    assert selected(gains, (), SETTINGS.selection.further_measured) == ("a", "b")
    assert verdict(gains, 0.0, (), SETTINGS.selection.further_measured).primary == ("a", "b")

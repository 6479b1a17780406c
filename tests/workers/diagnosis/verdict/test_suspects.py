"""Selection of effects for joint fits, and the requests of a whole course."""

from collections.abc import Callable, Mapping, Sequence
from types import MethodType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, ScreeningResult
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.verdict import diagnosis_course
from palpate.workers.diagnosis.verdict.diagnosis_course import (
    Diagnosis,
    advance,
    base_of,
    diagnose,
    extensions,
    suspects,
)
from palpate.workers.organs.breast.breast_effects import CATALOGUE

effect = CATALOGUE.named
EDGE_SD_MM = 5.0
RNG = np.random.default_rng(3)
PATTERN = RNG.standard_normal(30)
FIRST, FURTHER = SETTINGS.selection.first, SETTINGS.selection.further


def screened(
    name: str, nats: float, estimate: float = 1.0, *, hides: bool = False
) -> ScreeningResult:
    one = np.array([estimate])
    return ScreeningResult(name, nats, one, one, nats, 0.0, hides, 0, one)


def sensitivity(name: str, large: float, small: float) -> EffectSensitivity:
    """Return an effect with given responses per unit at a large and at a small magnitude."""
    columns = np.stack([large * PATTERN, small * PATTERN])[:, :, None]
    return EffectSensitivity(
        name, "plate geometry", columns, np.array([EDGE_SD_MM]), np.ones(1, np.bool_)
    )


def named(louder: dict[str, float], edge: ScreeningResult, large: float, small: float) -> list[str]:
    """Return the suspects among strong effects, a weak saturating friction, and an edge."""
    friction = screened("plate_friction", 9.0, 40.0)
    others = [screened(name, nats) for name, nats in louder.items()]
    analysis: Any = SimpleNamespace(
        screening=[*others, friction, edge],
        sensitivity_by_name={
            "plate_friction": sensitivity("plate_friction", 1.0, 2.0),
            "plate_edge": sensitivity("plate_edge", large, small),
        }
        | {name: sensitivity(name, 1.0, 1.0) for name in louder},
    )
    analysis.is_steep = MethodType(NominalAnalysis.is_steep, analysis)
    known = {one.name: effect(one.name) for one in analysis.screening}
    return [one.name for one in suspects(analysis, known)]


@pytest.mark.parametrize(("loudest", "nats"), [(119.0, 8.0), (17.0, 3.0)])
def test_a_quadratic_edge_is_fitted_with_stronger_effects(loudest: float, nats: float) -> None:
    loud = ["plate_flex", "plate_tilt", "skin_added", "creep"]
    louder = {name: loudest - n for n, name in enumerate(loud)}
    found = named(louder, screened("plate_edge", nats, 4.0), 2.0, 1.0)
    assert found == [*loud, "plate_edge"]


@pytest.mark.parametrize(
    ("loudest", "nats", "large"),
    [
        (9.5, 8.0, 2.0),  # the nominal model is near enough for a linear model
        (119.0, 0.5, 2.0),  # no support for the edge
        (119.0, 8.0, 0.9),  # its response saturates
    ],
)
def test_only_the_four_strongest_effects_are_fitted_otherwise(
    loudest: float, nats: float, large: float
) -> None:
    loud = ["plate_flex", "plate_tilt", "skin_added", "creep", "wall_hold"]
    louder = {name: loudest - n for n, name in enumerate(loud)}
    edge = screened("plate_edge", nats, 9.0)
    assert named(louder, edge, large, 1.0) == loud[:4]


Names = tuple[str, ...]
Supports = Mapping[str, float]


def fake_fit(names: Names, gain: float) -> Any:
    """Return a fit whose linearisation, with parameters at bounds held, is its names."""

    def holding(which: Any) -> Names:
        assert which.tolist() == [True, False]
        return names

    at = SimpleNamespace(
        at_bound=np.array([-1, 0]),
        linearised=lambda inverse: SimpleNamespace(holding=holding),
        names=names,
    )
    effects = tuple(SimpleNamespace(name=name) for name in names)
    return SimpleNamespace(names=names, effects=effects, fit=at, log_evidence=100.0 + gain)


def analysed(
    screening: Supports, hidden: Sequence[str] = (), left: Callable[[Names], float] | float = 0.0
) -> Any:
    """Return an analysis with evidence of 100 nats and fake effects."""
    found = [screened(name, nats, hides=name in hidden) for name, nats in screening.items()]
    gain = left if callable(left) else lambda names: left
    return SimpleNamespace(
        screening=sorted(found, key=lambda one: -one.log_bayes_factor),
        sensitivities=[SimpleNamespace(name=name) for name in screening],
        hidden=set(hidden),
        log_evidence=100.0,
        nominal=SimpleNamespace(names=()),
        inverse=SimpleNamespace(is_segmented=True),
        is_steep=lambda effect: False,
        field_gain=lambda fit: gain(fit.names),
    )


def run(
    analysis: Any,
    gains: Callable[[frozenset[str]], float | None],
    left_to: Callable[[Names, str], float],
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[Diagnosis, list[list[Names]]]:
    """Run a course with fake fits; return its end and its requests.

    `gains` returns None for a combination that cannot be simulated; `left_to` is the support that
    the residuals of a fit give to another effect.
    """

    def screen(names: Names, sensitivities: Any) -> list[ScreeningResult]:
        found = [screened(one.name, left_to(names, one.name)) for one in sensitivities]
        return sorted(found, key=lambda one: -one.log_bayes_factor)

    monkeypatch.setattr(diagnosis_course, "screen", screen)
    known: Any = [SimpleNamespace(name=one.name) for one in analysis.screening]
    course, requests = diagnose(analysis, known), []
    reached = advance(course)
    while not isinstance(reached, Diagnosis):
        names = [tuple(e.name for e in effects) for effects in reached]
        requests.append(names)
        answer: Any = []
        for who in names:
            gain = gains(frozenset(who))
            answer.append(None if gain is None else fake_fit(who, gain))
        reached = advance(course, answer)
    return reached, requests


def table(
    gains: Mapping[str, float | None], otherwise: float = 0.0
) -> Callable[[frozenset[str]], float | None]:
    """Return the gains of combinations, which are written as words."""
    of = {frozenset(who.split()): gain for who, gain in gains.items()}
    return lambda names: of.get(names, otherwise)


def loud(names: Names, other: str) -> float:
    return 30.0


def silent(names: Names, other: str) -> float:
    return SETTINGS.joint_fits.second_share * FURTHER


def test_nothing_is_fitted_if_nothing_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    analysis = analysed({"a": SETTINGS.joint_fits.least_gain, "b": -2.0})
    found, requests = run(analysis, table({}), loud, monkeypatch)
    assert requests == []
    assert found.verdict.kind == "no-gap"
    assert found.best is None


def test_extends_the_best_effect_until_nothing_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = table({"a": 20.0, "b": 50.0, "c": 10.0, "b c": 90.0, "b a": 55.0}, 80.0)
    support = {("b",): {"a": 12.0, "c": 40.0}}

    def left(names: Names, other: str) -> float:
        return support.get(names, {}).get(other, 0.0)

    found, requests = run(analysed({"a": 30.0, "b": 20.0, "c": 5.0}), gains, left, monkeypatch)
    assert requests == [[("a",), ("b",), ("c",)], [("b", "c"), ("b", "a")]]
    assert found.verdict.primary == ("b", "c")
    assert found.best is found.joint_fits["b", "c"]
    assert found.gain(("b", "c")) == pytest.approx(90.0)


def test_stops_at_three_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    screening = dict.fromkeys("abcde", 20.0)
    found, requests = run(analysed(screening), lambda who: 40.0 * len(who), loud, monkeypatch)
    assert found.verdict.primary == ("a", "b", "c")
    assert requests == [
        [("a",), ("b",), ("c",), ("d",)],
        [("a", "b"), ("a", "c")],
        [("a", "b", "c"), ("a", "b", "d")],
    ]


def test_stops_if_no_pair_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    found, requests = run(
        analysed({"a": 20.0, "b": 10.0}), table({"a": 30.0}, 30.0 + FURTHER), loud, monkeypatch
    )
    assert requests == [[("a",), ("b",)], [("b", "a")]]
    assert found.verdict.primary == ("b",)


def test_weak_support_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = table({"a": 30.0, "b": 10.0})
    found, requests = run(analysed({"a": 20.0, "b": 10.0}), gains, silent, monkeypatch)
    assert requests == [[("a",), ("b",)]]
    assert found.verdict.kind == "effect"


def test_every_visible_effect_is_fitted_before_none_of_these(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Screening missed the effect that acts, which then has a partner."""
    screening = {"a": 5.0, "missed": -3.0, "hidden": 90.0, "b": 0.0}
    analysis = analysed(screening, ["hidden"], left=lambda names: 5.0 if names else 40.0)
    gains = table({"a": 2.0, "missed": 60.0, "missed b": 99.0})
    found, requests = run(analysis, gains, loud, monkeypatch)
    assert requests == [
        [("a",)],
        [("b",), ("missed",)],
        [("missed", "a"), ("missed", "b")],
        [("missed", "b", "a")],
    ]
    assert found.verdict.kind == "effect"
    assert found.verdict.primary == ("missed", "b")
    assert found.verdict.hidden == ("hidden",)


def test_a_field_larger_than_the_named_effect_asks_for_every_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    analysis = analysed({"a": 50.0, "b": 0.0}, left=60.0)
    found, requests = run(analysis, table({"a": 40.0}), silent, monkeypatch)
    assert requests == [[("a",)], [("b",)]]
    assert found.verdict.kind == "none-of-these"
    assert found.best is None


def test_a_failed_fit_is_not_requested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    analysis = analysed({"a": 50.0, "b": 20.0, "c": 0.0}, left=99.0)
    gains = table({"a": 40.0, "b": None, "a c": None, "a b": None, "c": 1.0})
    found, requests = run(analysis, gains, loud, monkeypatch)
    assert requests == [[("a",), ("b",)], [("a", "b"), ("a", "c")], [("c",)]]
    assert set(found.joint_fits) == {("a",), ("c",)}


def test_extensions_exclude_hidden_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        diagnosis_course, "screen", lambda at, others: [screened(o.name, 50.0) for o in others]
    )
    analysis = analysed({"a": 20.0, "b": 20.0, "c": 20.0}, ["b"])
    known: Any = {name: SimpleNamespace(name=name) for name in "abc"}
    (found,) = extensions(analysis, known, fake_fit(("a",), 30.0))
    assert [one.name for one in found] == ["a", "c"]


@given(st.data())
def test_every_course_ends_and_requests_nothing_twice(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 6))
    names = "abcdef"[:count]
    nats = st.integers(-2, 15).map(lambda n: 6.0 * n)
    screening = {name: data.draw(nats) for name in names}
    hidden = data.draw(st.sets(st.sampled_from(names), max_size=2))
    left = data.draw(nats)
    drawn: dict[Any, float | None] = {}

    def gains(who: frozenset[str]) -> float | None:
        return drawn.setdefault(who, data.draw(st.one_of(st.none(), nats)))

    def left_to(who: Names, other: str) -> float:
        return drawn.setdefault((who, other), data.draw(nats)) or 0.0

    with pytest.MonkeyPatch.context() as patch:
        found, requests = run(analysed(screening, sorted(hidden), left), gains, left_to, patch)
    asked = [frozenset(who) for some in requests for who in some]
    assert len(set(asked)) == len(asked)
    assert all(1 <= len(who) <= 3 and not who & hidden for who in asked)
    assert [] not in requests
    # Each combination extends one that has been fitted.
    for number, some in enumerate(requests):
        before = {frozenset(who) for earlier in requests[:number] for who in earlier}
        bases = [base_of([SimpleNamespace(name=n) for n in who]) for who in some]
        assert all(not base or frozenset(base) in before for base in bases)
    if found.verdict.kind == "none-of-these":
        assert {frozenset(name) for name in set(names) - hidden} <= set(asked)
    if found.verdict.primary:
        assert found.best is not None
        assert set(found.best.names) == set(found.verdict.primary)

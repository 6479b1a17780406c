"""Selection of effects for joint fits."""

from types import MethodType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, ScreeningResult
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.verdict.diagnosis_course import (
    Diagnosis,
    advance,
    diagnose,
    pairs,
    suspects,
    triples,
    unfitted,
    weigh,
)
from palpate.workers.diagnosis.verdict.hypotheses import Hypothesis
from palpate.workers.organs.breast.breast_effects import CATALOGUE

effect = CATALOGUE.named
EDGE_SD_MM = 5.0
RNG = np.random.default_rng(3)
PATTERN = RNG.standard_normal(30)


def screened(name: str, nats: float, estimate: float = 1.0) -> ScreeningResult:
    one = np.array([estimate])
    return ScreeningResult(name, nats, one, one, nats, 0.0, False, 0, one)


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
    loud = ["plate_flex", "plate_tilt", "skin_added", "creep", "wall_hold"]
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
def test_only_the_five_strongest_effects_are_fitted_otherwise(
    loudest: float, nats: float, large: float
) -> None:
    loud = ["plate_flex", "plate_tilt", "skin_added", "creep", "wall_hold", "growth"]
    louder = {name: loudest - n for n, name in enumerate(loud)}
    edge = screened("plate_edge", nats, 9.0)
    assert named(louder, edge, large, 1.0) == loud[:5]


@pytest.mark.parametrize("simulated", [True, False])
def test_every_named_effect_is_fitted(monkeypatch, simulated: bool) -> None:
    """An effect missed by screening but named by the verdict is fitted once and weighed again."""
    known = [effect("plate_tilt"), effect("rigid_motion")]
    fitted_at_weighing = []

    def weighed_up(analysis, known, joint_fits):
        fitted_at_weighing.append(set(joint_fits))
        hypotheses = {(("rigid_motion",), False): 0.9}
        return SimpleNamespace(
            kind="effect", primary=("rigid_motion",), hidden=(), hypotheses=hypotheses
        ), ()

    analysis: Any = SimpleNamespace(screening=[], sensitivities=[])
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course._weighed_up", weighed_up
    )
    course = diagnose(analysis, known)
    wanted = advance(course)
    assert wanted == [(known[1],)]
    answer: Any = [SimpleNamespace(names=("rigid_motion",)) if simulated else None]
    reached = advance(course, answer)
    assert isinstance(reached, Diagnosis)
    assert fitted_at_weighing == [set(), {("rigid_motion",)} if simulated else set()]
    assert set(reached.joint_fits) == fitted_at_weighing[1]


def test_every_visible_effect_is_fitted_before_none_of_these(monkeypatch) -> None:
    known = [effect("plate_tilt"), effect("skin_added")]
    weak = screened("skin_added", 0.0, 1.0)

    def weighed_up(analysis, known, joint_fits):
        weighed = dict.fromkeys(((names, False) for names in joint_fits), 0.5)
        kind = "effect" if ("skin_added",) in joint_fits else "none-of-these"
        return SimpleNamespace(kind=kind, primary=(), hidden=(), hypotheses=weighed), ()

    analysis: Any = SimpleNamespace(screening=[weak], sensitivities=[])
    for name in ("suspects", "pairs", "triples"):
        monkeypatch.setattr(
            f"palpate.workers.diagnosis.verdict.diagnosis_course.{name}", lambda *_: []
        )
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course._weighed_up", weighed_up
    )
    course = diagnose(analysis, known)
    assert advance(course) == [(known[1],)]
    answer: Any = [SimpleNamespace(names=("skin_added",))]
    reached = advance(course, answer)
    assert isinstance(reached, Diagnosis) and reached.verdict.kind == "effect"


def joint_fit(names: str, log_evidence: float) -> Any:
    """Return a fit of one to three effects."""
    found = fitted("plate_tilt", log_evidence)
    found.names = tuple(names.split())
    found.effects = tuple(effect(name) for name in found.names)
    found.fit.linearised = lambda inverse: Left(found.names)
    return found


@pytest.fixture
def supported(monkeypatch) -> tuple[Any, dict[str, Any]]:
    """An analysis in which the residuals of every fit support a skin, and the catalogue."""
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course.screen",
        lambda *_: [screened("skin_added", 30.0)],
    )
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course._is_unexplained", lambda *_: True
    )
    analysis = SimpleNamespace(sensitivities=[], inverse=SimpleNamespace(coarsening=0.3))
    known = {name: effect(name) for name in ("plate_tilt", "growth", "creep", "skin_added")}
    return analysis, known


def test_two_effects_extend_single_ones(supported) -> None:
    """Fits of two and three effects are known when all visible effects are fitted."""
    found = [{one.name for one in effects} for effects in pairs(*supported, FITS)]
    assert found == [{"plate_tilt", "skin_added"}, {"plate_tilt", "creep"}]


def test_three_effects_extend_the_best_two(supported) -> None:
    """The best three are not extended, because a hypothesis has at most three effects."""
    (found,) = triples(*supported, FITS)
    assert [one.name for one in found] == ["plate_tilt", "growth", "skin_added"]
    assert triples(*supported, [joint_fit("growth", 90.0), *FITS]) == []


@pytest.mark.parametrize("zeta", [1.0, 0.3])
def test_every_nat_of_evidence_counts_zeta(monkeypatch, zeta: float) -> None:
    evidence = {(): Hypothesis((), -90.0, 20.0), ("growth",): Hypothesis(("growth",), -40.0)}
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course.JointEvidence",
        lambda *_: SimpleNamespace(hypothesis=evidence.__getitem__),
    )
    analysis: Any = SimpleNamespace(
        hypothesis=lambda fit: None,
        nominal=None,
        noise=None,
        sensitivities=[sensitivity("growth", 1.0, 1.0)],
        inverse=SimpleNamespace(coarsening=zeta),
    )
    nothing, growth = weigh(analysis, {})
    assert growth.log_evidence - nothing.log_evidence == pytest.approx(50 * zeta)
    assert nothing.discrepancy_gain == pytest.approx(20 * zeta)
    assert growth.discrepancy_gain is None


def test_supported_hidden_effects_are_fitted():
    """They are fitted alone and with the likeliest visible effect; creep is too improbable."""
    reached: Any = SimpleNamespace(
        primary=("growth",),
        hidden=("plate_force", "creep"),
        probabilities={"plate_force": 0.4, "creep": 0.05, "growth": 0.5},
        hypotheses={(("plate_tilt",), False): 0.01, (("growth",), False): 0.5},
    )
    pair = ("plate_tilt", "growth")
    wanted = unfitted(reached, [("plate_tilt",), ("growth",), pair])
    assert wanted == [("plate_force",), ("growth", "plate_force")]
    assert unfitted(reached, [("plate_tilt",), pair, *wanted]) == [("plate_tilt", "plate_force")]
    assert unfitted(reached, []) == [("growth",), ("plate_force",)]


class Left:
    """Residuals of a joint fit, passed to `screen` with the parameters at bounds held."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def holding(self, which: Any) -> tuple[str, ...]:
        assert which.tolist() == [True, False]
        return self.names


def fitted(name: str, log_evidence: float) -> Any:
    at = SimpleNamespace(at_bound=np.array([-1, 0]), linearised=lambda inverse: Left((name,)))
    return SimpleNamespace(
        names=(name,), effects=(effect(name),), fit=at, log_evidence=log_evidence
    )


FITS = [
    joint_fit("plate_tilt", 50.0),
    joint_fit("creep", 40.0),
    joint_fit("plate_tilt growth", 80.0),
    joint_fit("plate_tilt growth creep", 120.0),
]


@pytest.mark.parametrize(
    ("left", "unexplained", "expected"),
    [
        # The remainder of the best single effect supports a pair better than any other could be.
        (
            {"plate_tilt": {"growth": 40.0}, "skin_added": {"growth": 45.0}},
            False,
            [("plate_tilt", "growth")],
        ),
        # Another effect leaves more, so its pairs come first, each once. 9 nats are too few.
        (
            {
                "plate_tilt": {"growth": 20.0, "skin_added": 14.0, "creep": 9.0},
                "skin_added": {"growth": 60.0, "plate_tilt": 35.0, "creep": 25.0},
            },
            False,
            [("skin_added", "growth"), ("plate_tilt", "skin_added"), ("plate_tilt", "growth")],
        ),
        # The best effect leaves nothing, so there is no pair, although others leave much.
        ({"plate_tilt": {}, "skin_added": {"growth": 60.0}}, False, []),
        # The exception is when a smooth field explains the residuals.
        ({"plate_tilt": {}, "skin_added": {}}, True, [("plate_tilt", "skin_added")]),
    ],
)
def test_fits_the_most_promising_pairs(monkeypatch, left, unexplained, expected) -> None:
    """Two effects, 10 nats apart, were fitted alone; `left` is the gain each leaves to others."""

    def screen(names: tuple[str, ...], sensitivities: Any) -> list[ScreeningResult]:
        found = [screened(name, nats) for name, nats in left[names[0]].items()]
        return sorted(found, key=lambda one: -one.log_bayes_factor)

    monkeypatch.setattr("palpate.workers.diagnosis.verdict.diagnosis_course.screen", screen)
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.diagnosis_course._is_unexplained", lambda *_: unexplained
    )
    analysis: Any = SimpleNamespace(sensitivities=[], inverse=SimpleNamespace(coarsening=0.3))
    known = {name: effect(name) for name in ("plate_tilt", "skin_added", "growth", "creep")}
    found = pairs(analysis, known, [fitted("skin_added", 90.0), fitted("plate_tilt", 100.0)])
    assert [tuple(one.name for one in pair) for pair in found] == expected

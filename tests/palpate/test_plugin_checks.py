"""`palpate.testing` accepts the built-ins and names the errors of broken plug-ins."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from palpate.service.search.search_interface import Proposal, Stopped
from palpate.service.search.search_keys import CMA, GENETIC, LEAST_SQUARES, POLISHED, Strategy
from palpate.storage.values import FloatArray, Volume
from palpate.testing import check_effect, check_law, check_organ, check_score, check_search
from palpate.testing.plugin_claims import plain_problem
from palpate.workers.comparison.score_objective import GSF, HAUSDORFF, JACCARD, Objective
from palpate.workers.mechanics.effects.loading_effects import GRAVITY_CHANGE
from palpate.workers.mechanics.effects.material_effects import COMPRESSIBILITY, SKIN_SCALED
from palpate.workers.mechanics.effects.observation_effects import RIGID_MOTION, SEGMENTATION_OFFSET
from palpate.workers.mechanics.effects.support_effects import FRICTION, WALL_HOLD
from palpate.workers.mechanics.fem.boundary_value_problem import Membrane
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin, NeoHookean, Yeoh
from palpate.workers.organs.breast.plugin import BREAST_PLUGIN
from palpate.workers.organs.cornea.plugin import CORNEA_PLUGIN

BREAST_CASE = {"reference": {"phantom": {"spacing_mm": 2}}, "mesh": {"nodes": 1200}}
CORNEA_CASE = {"mesh": {"elements": 100}}


@pytest.mark.parametrize(
    "effect",
    [WALL_HOLD, FRICTION, COMPRESSIBILITY, RIGID_MOTION, SEGMENTATION_OFFSET],
    ids=lambda e: e.name,
)
def test_built_in_effects_pass(effect: Any) -> None:
    check_effect(effect)


def test_an_effect_is_checked_on_the_problem_that_it_acts_on() -> None:
    with pytest.raises(AssertionError, match="skin_scaled changes nothing at plausible values"):
        check_effect(SKIN_SCALED)
    check_effect(SKIN_SCALED, replace(plain_problem(), membrane=Membrane(0.2, 1.5)))


@pytest.mark.parametrize(
    "law",
    [
        NeoHookean(0.003),
        MooneyRivlin(0.16, 0.05),
        Yeoh(0.002, 0.01, 0.3),
        Fung(0.0009, 4.0),
        Ogden((0.63, 0.0012), (1.3, 5.0)),
    ],
    ids=lambda law: type(law).__name__,
)
def test_built_in_laws_pass(law: Any) -> None:
    check_law(law)


@pytest.mark.parametrize("score", [GSF, JACCARD, HAUSDORFF], ids=lambda s: s.name)
def test_built_in_scores_pass(score: Objective) -> None:
    check_score(score)


@pytest.mark.parametrize("strategy", [GENETIC, CMA, LEAST_SQUARES, POLISHED], ids=lambda s: s.name)
def test_built_in_strategies_pass(strategy: Strategy) -> None:
    check_search(strategy)


def test_built_in_organs_pass() -> None:
    check_organ(BREAST_PLUGIN, BREAST_CASE, free=["E_fat", "E_glandular"])
    check_organ(CORNEA_PLUGIN, CORNEA_CASE, free=["mu1"])


# Ten plug-ins, each with one mistake.


def _always_heavier(problem: Any, values: Any, frame: Any) -> Any:
    x, y, z = problem.gravity_g
    return replace(problem, gravity_g=(x + 0.01 + values["gravity_x"], y, z))


def _forgetful(problem: Any, values: Any, frame: Any) -> Any:
    return problem


def _wrong_rows(points: FloatArray, normals: FloatArray, tissues: Any, frame: Any) -> FloatArray:
    return np.ones((len(points), 2))


@dataclass(frozen=True)
class WrongStress(NeoHookean):
    """A neo-Hookean law with a missing factor in its stress."""

    def stress(self, F: FloatArray) -> FloatArray:
        """See `Law.stress`."""
        return 1.01 * super().stress(F)


@dataclass(frozen=True)
class Stiffest(NeoHookean):
    """A neo-Hookean law with fibres along x: it is not isotropic."""

    def energy(self, F: FloatArray) -> FloatArray:
        """See `Law.energy`."""
        J = np.linalg.det(F)
        along = (F[..., :, 0] ** 2).sum(axis=-1) / np.cbrt(J) ** 2
        return super().energy(F) + 0.1 * self.mu_mpa * (along - 1) ** 2


def _likeness(target: Volume) -> Callable[[Any], float]:
    return lambda body: float((body.values == target.values).mean())


def _overwriting(target: Volume) -> Callable[[Any], float]:
    def measure(body: Volume) -> float:
        apart = float((body.values != target.values).mean())
        body.values[:] = target.values
        return apart

    return measure


class Drawn:
    """A search that draws new candidates at every call."""

    def __init__(self, asked: Any) -> None:
        self.space, self.rng = asked.search.space, np.random.default_rng()

    def propose(self, history: Any) -> Proposal | Stopped:
        """See `Search.propose`."""
        if len(history) == 5:
            return Stopped("enough")
        low, high = np.array(self.space.lower), np.array(self.space.upper)
        return Proposal(self.rng.uniform(low, high, (8, len(low))), (None,) * 8)


class Outside(Drawn):
    """A search that leaves the bounds."""

    def propose(self, history: Any) -> Proposal | Stopped:
        """See `Search.propose`."""
        if len(history) == 3:
            return Stopped("enough")
        high = np.array(self.space.upper) * (1.5 - 0.1 * len(history))
        return Proposal(np.tile(high, (4, 1)), (None,) * 4)


def _strategy(make: Any) -> Strategy:
    return replace(GENETIC, name="own", make=make)


BROKEN: dict[str, tuple[Callable[[], None], str]] = {
    "an effect that cannot be pickled": (
        lambda: check_effect(replace(GRAVITY_CHANGE, transform=lambda p, v, f: p)),
        "cannot be pickled",
    ),
    "an effect that acts at its neutral value": (
        lambda: check_effect(replace(GRAVITY_CHANGE, transform=_always_heavier)),
        "changes the problem at its neutral values",
    ),
    "an effect that does nothing": (
        lambda: check_effect(replace(GRAVITY_CHANGE, transform=_forgetful)),
        "changes nothing at plausible values",
    ),
    "an effect with a name in use": (
        lambda: check_effect(replace(WALL_HOLD, name="own_hold")),
        "has parameter names that breast already uses",
    ),
    "an observation of a wrong shape": (
        lambda: check_effect(replace(RIGID_MOTION, observation=_wrong_rows)),
        "one row per point and one column per parameter",
    ),
    "a law whose stress is not the derivative of its energy": (
        lambda: check_law(WrongStress(0.003)),
        "the stress is not the derivative of the energy",
    ),
    "a law with a direction": (lambda: check_law(Stiffest(0.003)), "is not isotropic"),
    "a score of the wrong direction": (
        lambda: check_score(Objective("likeness", "Likeness", "lower", measure=_likeness)),
        "does not score the target itself best",
    ),
    "a score that changes bodies": (
        lambda: check_score(Objective("apart", "Apart", measure=_overwriting)),
        "gives different values from one call to the next|changes the bodies",
    ),
    "a search that redraws candidates": (
        lambda: check_search(_strategy(Drawn)),
        "proposes different candidates",
    ),
    "a search that leaves its bounds": (
        lambda: check_search(_strategy(Outside)),
        "outside the bounds",
    ),
    "an organ under another name": (
        lambda: check_organ(replace(BREAST_PLUGIN, name="udder"), BREAST_CASE),
        "is named 'breast'",
    ),
    "an organ whose checks are missing": (
        lambda: check_organ(
            replace(BREAST_PLUGIN, checks="palpate.workers.organs.breast.nowhere:CHECKS"),
            BREAST_CASE,
        ),
        "breast.checks: No module named",
    ),
    "an organ with the study kind of another": (
        lambda: check_organ(
            replace(CORNEA_PLUGIN, study_kind=BREAST_PLUGIN.study_kind), CORNEA_CASE
        ),
        "breast already uses the study kind 'breast study'",
    ),
    "an organ with a template of another": (
        lambda: check_organ(replace(CORNEA_PLUGIN, templates=BREAST_PLUGIN.templates), CORNEA_CASE),
        "breast already has a template named breast",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_error_names_violated_condition(name: str) -> None:
    check, words = BROKEN[name]
    with pytest.raises(AssertionError, match=words):
        check()

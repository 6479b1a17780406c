"""Corners of the search box of a breast's constants.

At the softest corners 100 N flatten the breast by two thirds; at the stiffest the
skin is 600 times as stiff as the fat, and is wrinkled everywhere. A search needs a
sound equilibrium at each corner.
"""

import itertools
from functools import cache

import numpy as np
import pytest

from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.boundary_value_problem import Outcome
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.model_parameters import BREAST
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_problem import Extent, extent_of

BARE = ("E_fat", "eta_fat", "E_glandular", "eta_glandular")
COVERED = (*BARE, "E_skin")
Corner = tuple[int, ...]

QUICK = [(0, 0, 0, 0), (0, 1, 1, 1), (1, 0, 0, 1), (0, 0, 1, 0, 0), (0, 1, 0, 1, 1)]


def corners(names: tuple[str, ...]) -> list[Corner]:
    return list(itertools.product((0, 1), repeat=len(names)))


def case(skin: str) -> BreastCase:
    return validated(
        BreastCase,
        {
            "reference": {"phantom": {"spacing_mm": 1.0}},
            "mesh": {"nodes": 5000},
            "load": {"force_n": 100.0},
            "model": {"skin": skin},
        },
    )


@cache
def breast() -> tuple[Model, Extent]:
    asked = case("none")
    labels = ORGAN.make_body(asked.reference)
    return prepare(ORGAN.make_mesh(labels, asked)), extent_of(labels)


@cache
def press(corner: Corner) -> Outcome:
    """Press a breast with its first constants at their lower (0) or upper (1) bounds."""
    names = COVERED[: len(corner)]
    constants = {name: BREAST[name].bounds[end] for name, end in zip(names, corner, strict=True)}
    asked = case("membrane" if len(corner) == len(COVERED) else "none")
    model, body = breast()
    problem = ORGAN.problem(model, asked, asked.complete(constants), body)
    return ORGAN.solve(model, problem).outcome


def assert_in_equilibrium(outcome: Outcome) -> None:
    assert outcome.converged, outcome.reason
    assert outcome.plate_force_n == pytest.approx(100, rel=1e-4)
    assert outcome.force_imbalance < 5e-3
    assert outcome.residual_n < 0.05
    assert outcome.penetration_mm < 0.5


def assert_sound(outcome: Outcome) -> None:
    assert outcome.min_j >= 0.2
    assert outcome.squeezed == (outcome.min_j < 0.3)


@pytest.mark.parametrize("corner", QUICK, ids=str)
def test_some_corners_have_a_sound_equilibrium(corner: Corner) -> None:
    outcome = press(corner)
    assert_in_equilibrium(outcome)
    assert_sound(outcome)


@pytest.mark.slow
@pytest.mark.parametrize("corner", corners(BARE) + corners(COVERED), ids=str)
def test_every_corner_has_a_sound_equilibrium(corner: Corner) -> None:
    outcome = press(corner)
    assert_in_equilibrium(outcome)
    assert_sound(outcome)
    assert sum(outcome.newton_iterations) < 60


@pytest.mark.slow
@pytest.mark.parametrize("names", [BARE, COVERED], ids=["bare", "covered"])
def test_stiffer_corners_yield_less(names: tuple[str, ...]) -> None:
    """Along every edge of the box the plate moves less at the stiff end."""
    for corner in corners(names):
        for k in np.flatnonzero(np.array(corner) == 0):
            stiffer = (*corner[:k], 1, *corner[k + 1 :])
            soft, stiff = press(corner), press(stiffer)
            assert stiff.plate_displacement_mm < soft.plate_displacement_mm, (corner, names[k])

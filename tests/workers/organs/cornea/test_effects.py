"""Effects of a cornea: neutral values, and derivatives against differences of solutions."""

from typing import Any

import numpy as np
import pytest

from palpate.workers.common_keys import validated
from palpate.workers.mechanics.effects.effect import Effect, one_sided
from palpate.workers.organs.cornea.cornea_effects import CORNEA_EFFECTS, peaked
from palpate.workers.organs.cornea.cornea_forward import CorneaForward, CorneaProblem
from palpate.workers.organs.cornea.cornea_keys import CORNEA, CorneaCase
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.cornea_problem import candidate_of
from palpate.workers.organs.cornea.cornea_study_source import frame_of_section
from palpate.workers.organs.cornea.corneal_model import CorneaLoad

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
CASE = validated(CorneaCase, {"organ": "cornea", "mesh": {"elements": 120}, "constants": X1})
MESH = ORGAN.make_mesh(ORGAN.make_body(CASE.reference), CASE)
FRAME = frame_of_section(MESH)
SOLVER = CorneaForward()
ON_BODY = [e for e in CORNEA_EFFECTS if e.observation is None]
# The edge of a uniform jet is on nodes, where the derivative has a kink, so steps must be small.
KINKED = {"jet_off_centre": 3e-3, "jet_width_error": 3e-3}


def named(effect: Effect) -> str:
    return effect.name


@pytest.fixture(scope="module")
def problem() -> CorneaProblem:
    return CorneaProblem(candidate_of(ORGAN.prepare(MESH), CASE, CASE.complete(), 0.0))


def test_names_are_unique_and_searched_ones_are_known() -> None:
    names = [name for e in CORNEA_EFFECTS for name in (e.name, *e.names)]
    assert len(names) == len(set(names)) + 1  # one parameter has the same name as its effect
    assert all(name in CORNEA for e in CORNEA_EFFECTS for name in e.searched_as)
    searched = {e.name for e in CORNEA_EFFECTS if e.is_searched(CORNEA)}
    assert searched == {
        "jet_off_centre",
        "jet_pressure_error",
        "jet_width_error",
        "iop_error",
        "iop_rise",
        "whole_eye_motion",
        "limbus_compliance",
        "stiffness_gradient",
    }


@pytest.mark.parametrize("effect", ON_BODY, ids=named)
def test_derivative_matches_differences_of_solutions(
    effect: Effect, problem: CorneaProblem
) -> None:
    where = {n: 0.1 * sd for n, sd in zip(effect.names, effect.prior_sd, strict=True)}
    at = effect.apply(problem, where, FRAME)
    solved = SOLVER.equilibrium(None, at)
    assert solved.solution.outcome.converged
    changes = effect.changes(problem, FRAME, where)
    slopes = SOLVER.tangents(solved, changes)
    for name, sd, slope in zip(effect.names, effect.prior_sd, slopes, strict=True):
        h = KINKED.get(effect.name, 1e-3) * sd
        ends = [
            SOLVER.equilibrium(None, effect.apply(problem, where | {name: where[name] + d}, FRAME))
            for d in (h, -h)
        ]
        u = [one.solution.displacement_mm for one in ends]
        expected = (u[0] - u[1]) / (2 * h)
        np.testing.assert_allclose(slope, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("effect", ON_BODY, ids=named)
def test_plausible_values_can_be_simulated(effect: Effect, problem: CorneaProblem) -> None:
    assert effect.apply(problem, effect.neutral, FRAME) is problem
    before = SOLVER.equilibrium(None, problem).solution.displacement_mm
    at = SOLVER.equilibrium(None, effect.apply(problem, effect.plausible, FRAME))
    assert at.solution.outcome.converged
    moved = np.abs(at.solution.displacement_mm - before).max()
    assert 1e-3 < moved < 0.6


def test_shares_interpolate_between_models(problem: CorneaProblem) -> None:
    effect = next(e for e in CORNEA_EFFECTS if e.name == "plane_strain")
    u = [
        SOLVER.equilibrium(
            None, effect.apply(problem, {"plane_strain_share": share}, FRAME)
        ).solution.displacement_mm
        for share in (0.0, 0.5, 0.999)
    ]
    np.testing.assert_allclose(u[1] - u[0], (u[2] - u[0]) * 0.5 / 0.999, atol=1e-9)
    assert one_sided(effect.parameters[0])


def test_a_peaked_jet_keeps_its_force() -> None:
    load = CorneaLoad(0.0014)
    for by in (-0.5, 0.3, 0.9):
        profile = peaked(load, by)
        r = np.linspace(0, 1.5, 20001)
        mean = np.trapezoid(profile.at(r) * r, r) / np.trapezoid(r, r)
        assert mean == pytest.approx(1.0, abs=1e-3)


def test_inconsistent_load_has_no_equilibrium(problem: CorneaProblem) -> None:
    effect: Any = next(e for e in CORNEA_EFFECTS if e.name == "jet_off_centre")
    off = SOLVER.equilibrium(None, effect.apply(problem, {"jet_offset": 9.0}, FRAME))
    assert not off.solution.outcome.converged
    assert "jet" in off.solution.outcome.reason


def test_derivative_with_respect_to_limbus_compliance_matches_a_difference(
    problem: CorneaProblem,
) -> None:
    """An elastic limbus has other unknowns than a held one."""
    effect = next(e for e in CORNEA_EFFECTS if e.name == "limbus_compliance")
    where = dict.fromkeys(effect.names, 0.0)
    solved = SOLVER.equilibrium(None, problem)
    (slope,) = SOLVER.tangents(solved, effect.changes(problem, FRAME, where))
    h = 1e-3 * effect.prior_sd[0]
    after = SOLVER.equilibrium(None, effect.apply(problem, {effect.names[0]: h}, FRAME))
    expected = (after.solution.displacement_mm - solved.solution.displacement_mm) / h
    np.testing.assert_allclose(slope, expected, atol=0.1 * np.abs(expected).max())

"""Stiffness from forces of a testing machine and a field of displacements."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.diagnosis.outcome.summarising import summarise
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Constants
from palpate.workers.mechanics.fem.equilibrium_sensitivity import reactions, tangents_with_reactions
from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.organs.specimen.observed_and_predicted import posterior_factor
from palpate.workers.tasks.diagnosis_tasks import model_displacements
from tests.workers.organs.specimen.experiments import SIZE, write
from tests.workers.organs.specimen.test_measured_boundary import (
    FORCE_N,
    NODES,
    NU,
    YOUNG_KPA,
    experiment,
)
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

SD_N = 0.001 * abs(FORCE_N)


def with_reactions(data, sd_n=SD_N, factor=1.0):
    """Add a load cell at the top that reads the theoretical force."""
    for state, size in zip(data["states"], (1.0, 0.5), strict=True):
        state["reactions"] = [
            {"region": "top", "axis": "z", "force_n": factor * size * FORCE_N, "sd_n": sd_n}
        ]
    return data


def block(folder):
    """Return a model and its first problem, with E = 0.12 MPa and nu = 0.35."""
    source = read_experiment(write(folder, with_reactions(experiment(folder))))
    model = source.inverse_problem(NODES).model
    problem = source.problem(source.spec.states[0])({"E": 0.12, "compressibility": 0.3})
    return model, problem


def further(problem, factor):
    """Scale the displacements of both ends."""
    holds = []
    for hold in problem.holds:
        field = hold.displacement_mm
        moved = tuple(tuple(factor * v for v in row) for row in field.displacement_mm)
        holds.append(replace(hold, displacement_mm=replace(field, displacement_mm=moved)))
    return replace(problem, holds=tuple(holds))


def test_reactions_match_uniaxial_stress(tmp_path):
    model, problem = block(tmp_path)
    found = reactions(equilibrium(model, further(problem, 0.1)))
    top = model.finest.nodes[:, 2] >= 40 - 1e-9
    tenth = 0.1 * FORCE_N
    assert found[top].sum(axis=0) == pytest.approx([0, 0, tenth], abs=0.001 * abs(tenth))
    assert found.sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-6)
    between = (model.finest.nodes[:, 2] > 8 + 1e-9) & ~top
    assert not found[between].any()


@pytest.mark.parametrize(
    "strain",
    [
        pytest.param(1.0, id="0.4 percent"),
        pytest.param(40.0, id="16 percent", marks=pytest.mark.slow),
    ],
)
def test_derivatives_of_reactions_match_finite_differences(tmp_path, strain):
    """Derivatives in stiffness, Poisson's ratio and displacement of the ends."""
    model, problem = block(tmp_path)
    problem = replace(further(problem, strain), tolerance_mm=1e-9)
    (tissue,) = problem.constants

    def stiffer(h):
        return replace(problem, constants={tissue: Constants(0.12 * (1 + h), 0.35)})

    def softer_in_volume(h):
        return replace(problem, constants={tissue: Constants(0.12, 0.35 + 0.1 * h)})

    at = equilibrium(model, problem)
    changed = [stiffer, softer_in_volume, lambda h: further(problem, 1 + h)]
    h = 1e-4
    changes = [Change(by(h), by(-h), 2 * h) for by in changed]
    moved, found = tangents_with_reactions(at, changes, 1e-9)
    top = model.finest.nodes[:, 2] >= 40 - 1e-9
    h = 1e-3
    for by, u, force in zip(changed, moved, found, strict=True):
        ends = [equilibrium(model, by(sign * h), at) for sign in (1, -1)]
        solved = np.subtract(*(reactions(end)[top].sum(axis=0) for end in ends)) / (2 * h)
        scale = abs(reactions(at)[top].sum(axis=0)[2])
        assert force[top].sum(axis=0) == pytest.approx(solved, abs=2e-4 * scale)
        places = np.subtract(*(end.solution.displacement_mm for end in ends)) / (2 * h)
        assert u == pytest.approx(places, abs=1e-3 * np.abs(places).max() + 1e-6)


@pytest.mark.slow
def test_stiffness_needs_a_force_and_nu_only_the_field(tmp_path):
    """Both ends move as measured, so stiffness is not identifiable without the force."""
    source = read_experiment(write(tmp_path, with_reactions(experiment(tmp_path))))
    inverse, found = calibrate(source.inverse_problem(NODES), None)
    values = found.values()
    assert values["E"] == pytest.approx(YOUNG_KPA * 1e-3, rel=0.01)  # finite strains
    assert (1 - values["compressibility"]) / 2 == pytest.approx(NU, abs=0.003)
    spread = posterior_factor(inverse, found)
    # Two readings, with errors of 0.1 % and 0.2 %, and the noise of the ends.
    assert 0.0008 < np.sqrt((spread[0] ** 2).sum()) < 0.01
    alone = read_experiment(write(tmp_path, experiment(tmp_path)))
    inverse, found = calibrate(alone.inverse_problem(NODES), None)
    spread = posterior_factor(inverse, found)
    assert np.sqrt((spread[0] ** 2).sum()) == pytest.approx(found.unknowns.sd[0], rel=1e-3)


@pytest.mark.slow
def test_readings_are_weighted_by_their_noise(tmp_path):
    """Two cells that disagree, one at each end, give their weighted mean."""
    data = with_reactions(experiment(tmp_path, nu=NU))
    for state, size in zip(data["states"], (1.0, 0.5), strict=True):
        force = -1.05 * size * FORCE_N
        wider = {"region": "bottom", "axis": "z", "force_n": force, "sd_n": 3 * SD_N}
        state["reactions"].append(wider)
    source = read_experiment(write(tmp_path, data))
    inverse = source.inverse_problem(NODES)
    values = calibrate(inverse, None)[1].values()
    alone = read_experiment(write(tmp_path, with_reactions(experiment(tmp_path, nu=NU))))
    before = calibrate(alone.inverse_problem(NODES), None)[1].values()
    assert values["E"] == pytest.approx(before["E"] * (1 + 0.05 / 10), rel=1e-3)


@pytest.mark.slow
def test_summary_has_measured_and_predicted_forces(tmp_path):
    data = with_reactions(experiment(tmp_path))
    stated = [
        {"region": "bottom", "displacement_mm": [0, 0, 0]},
        {"region": "top", "displacement_mm": [0, 0, -0.3], "axes": ["z"]},
    ]
    data["predict"] = [
        {"name": "further", "moves": stated},
        {"name": "released", "moves": stated[:1]},
    ]
    source = read_experiment(write(tmp_path, data))
    effects = ["stiffness_gradient", "strain_stiffening", "frame_turn"]
    store = diagnosed_store(source, tmp_path / "store", NODES, 0.0, effects)
    diagnosis = diagnosis_in(store)
    summary = summarise(diagnosis, store.effects, source.name)
    moved = model_displacements(diagnosis, map)
    _, summary = source.describe(diagnosis, moved, summary, None)
    assert summary.verdict == "no-gap"
    first, second = summary.markers
    assert [r.force_n for r in (*first.reactions, *second.reactions)] == [FORCE_N, FORCE_N / 2]
    for reaction in (*first.reactions, *second.reactions):
        assert abs(reaction.before_n) < 3 * reaction.sd_n
    assert summary.gap_mm.before.points == 2 * 3 * len(source.observed.points_mm)
    further, released = summary.predictions
    (force,) = further.reactions
    # The ends cannot contract, and a layer of 8 mm at each does not deform.
    stress = YOUNG_KPA * 1e-3 * -0.3 / 32 * SIZE[0] * SIZE[1]
    assert force.force_n == pytest.approx(stress, rel=0.1)
    assert 0 < force.sd_n < 0.02 * abs(stress)
    assert not released.reactions


@pytest.mark.parametrize(
    ("reactions", "words"),
    [
        ([{"region": "face", "axis": "z"}], "does not move there"),
        ([{"region": "top", "axis": "z"}] * 2, "each name once"),
        ([{"region": "top", "axis": "z", "sd_n": 0}], "greater than 0"),
    ],
)
def test_rejects_invalid_reactions(tmp_path, reactions, words):
    data = experiment(tmp_path)
    for state in data["states"]:
        state["reactions"] = [{"force_n": -1.0, "sd_n": 0.1} | one for one in reactions]
    with pytest.raises(InputError, match=words):
        read_experiment(write(tmp_path, data))


def test_rejects_reactions_that_differ_between_states(tmp_path):
    data = with_reactions(experiment(tmp_path))
    data["states"][1]["reactions"] = []
    with pytest.raises(InputError, match="the same in all states"):
        read_experiment(write(tmp_path, data))

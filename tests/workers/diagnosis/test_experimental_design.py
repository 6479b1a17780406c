"""Expected information of planned scans, compared with known answers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.expected_information import (
    Design,
    LoadSensitivity,
    assembled,
    deformed_normals,
    evaluate_design,
    load_sensitivity,
    loose,
    simulated,
)
from palpate.workers.diagnosis.fits.effect_screening import NONCENTRALITY
from palpate.workers.diagnosis.noise.noise_components import pose_columns
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.planned_acquisition import inverse_problem_of
from palpate.workers.diagnosis.scan_plan import (
    CandidateLoad,
    candidate_loads,
    designs,
    held_alike,
    make_plan,
    pressed_by,
    turned_to,
)
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, ForceControl, Wall
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.organs.breast.scanned_case import acquisition_of
from palpate.workers.organs.breast.scanned_case_files import read_case
from tests.workers.diagnosis.meant_case import NODES, SPACING_MM, at_distance, at_force, write_meant

effect = CATALOGUE.named
SUSPECTS = [
    effect(name)
    for name in (
        "plate_force",
        "plate_tilt",
        "strain_stiffening",
        "skin_scaled",
        "rigid_motion",
        "inclusion",
    )
]
LOW, HIGH = 0, 1
World = tuple[InverseProblem, list[CandidateLoad], dict[int, LoadSensitivity]]


def world(folder: Path, pressed: list[dict], which: list[int], springs: bool = True) -> World:
    """Return the body, all states, and the sensitivities of some of them."""
    acquisition = acquisition_of(read_case(write_meant(folder, pressed, springs), loaded=False))
    unloaded = inverse_problem_of(acquisition, NODES, SPACING_MM)
    states = candidate_loads(acquisition, unloaded.frame, unloaded.model.finest.nodes)
    found = {}
    for number in which:
        one = load_sensitivity(unloaded, states[number].name, states[number].problem, SUSPECTS)
        assert one is not None
        found[number] = one
    return unloaded, states, found


@pytest.fixture(scope="module")
def sliding(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Return two forces and a further view of a body on which only moduli balance the force."""
    folder = tmp_path_factory.mktemp("planned") / "case"
    return world(folder, [at_force(6), at_force(18)], [LOW, HIGH, 4], springs=False)


def chance(world_: World, design: Design):
    unloaded, _, found = world_
    suspects = simulated([found[s] for s in design.states], SUSPECTS)
    return evaluate_design(unloaded, design, found, suspects)


def row(world_: World, design: Design, name: str):
    return next(r for r in chance(world_, design).rows if r.name == name)


# Sensitivities of one scan


def test_normals_follow_uniform_stretch_and_rotation(sliding: World) -> None:
    """Nanson's formula, n' ~ F^-T n, is exact where F is the same everywhere."""
    unloaded, _, _ = sliding
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.8, 0.2], [0.0, 0.1, 1.1]])
    expected = unloaded.points.normals @ np.linalg.inv(F)
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    found = deformed_normals(unloaded, unloaded.model.finest.nodes @ (F - np.eye(3)).T)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_plate_row_equals_the_solver_travel(sliding: World) -> None:
    """Whole simulations are compared; plates also penetrate slightly due to the penalty."""
    unloaded, states, found = sliding
    middle = {f.name: float(np.exp(f.log_mean)) for f in unloaded.free}
    for column, name in enumerate(middle):
        travel = []
        for step in (0.03, -0.03):
            problem = states[HIGH].problem(middle | {name: middle[name] * np.exp(step)})
            travel.append(solve(unloaded.model, problem).outcome.plate_displacement_mm)
        expected = -(travel[0] - travel[1]) / 0.06
        assert found[HIGH].nominal[-1, column] == pytest.approx(expected, rel=0.03)


def test_effects_on_images_do_not_change_the_plate_row(sliding: World) -> None:
    columns = sliding[2][LOW].columns["rigid_motion"]
    assert (columns[-1] == 0).all()
    assert (np.abs(columns[:-1]).max(axis=0) > 0.5).any()


# Effects known to be hidden, and measurements that reveal them


def test_force_error_is_equivalent_to_a_change_in_moduli(sliding: World) -> None:
    """If only moduli resist, F and E enter as F / E, so F's column is minus the sum of E's columns.

    The penalty of the plates, an additional stiffness, has a slight influence.
    """
    for part in (sliding[2][LOW], sliding[2][HIGH]):
        of_force = part.columns["plate_force"][:, 0]
        of_moduli = part.nominal.sum(axis=1)
        assert np.linalg.norm(of_force + of_moduli) < 0.02 * np.linalg.norm(of_force)


@pytest.mark.parametrize(
    "design",
    [Design((LOW,)), Design((LOW, HIGH)), Design((LOW, HIGH, 4)), Design((LOW, HIGH), plates=True)],
)
def test_force_error_is_hidden_in_every_design(sliding: World, design: Design) -> None:
    assert row(sliding, design, "plate_force").absorbed > 0.99
    hidden = dict(zip(chance(sliding, design).names, chance(sliding, design).hidden, strict=True))
    assert hidden["plate_force"]


@pytest.mark.parametrize("known", [None, 0])
def test_force_error_is_bounded_only_by_known_moduli(sliding: World, known: int | None) -> None:
    """Images determine only F / E, so ln F is known as well as the ln E are together.

    Its information is the sum of theirs, 1 / sd^2 each, including that of a measurement to 10 %;
    the penalty of the plates adds a little.
    """
    information = sum(1 / f.log_sd**2 for f in sliding[0].free) + (100 if known == 0 else 0)
    found = row(sliding, Design((LOW, HIGH), known=known), "plate_force").minimum[0]
    assert found == pytest.approx(np.sqrt(NONCENTRALITY / information), rel=0.08)


def test_a_second_load_reveals_stiffening(sliding: World) -> None:
    one = row(sliding, Design((LOW,)), "strain_stiffening").minimum[0]
    two = row(sliding, Design((LOW, HIGH)), "strain_stiffening").minimum[0]
    assert two < 0.4 * one


def test_more_data_never_lower_the_information(sliding: World) -> None:
    """Minimum magnitudes never rise, and expected log evidences never fall."""
    before = chance(sliding, Design((LOW,)))
    for more in (
        Design((LOW, HIGH)),
        Design((LOW,), drawings=2),
        Design((LOW,), plates=True),
        Design((LOW,), known=1),
        Design((LOW, HIGH, 4), drawings=3, plates=True, known=0),
    ):
        after = chance(sliding, more)
        for a, b in zip(before.rows, after.rows, strict=True):
            assert (b.minimum <= a.minimum * (1 + 1e-9)).all(), (more, a.name)
        assert (after.evidence >= before.evidence - 1e-6 * (1 + before.evidence)).all()
        assert (after.separation >= before.separation * (1 - 1e-6) - 1e-6).all()


def test_four_segmentations_halve_their_noise(sliding: World) -> None:
    unloaded, _, found = sliding
    suspects = [effect("plate_tilt")]
    once, often = (
        assembled(unloaded, Design((LOW,), drawings=n), found, suspects)[0].covariance
        for n in (1, 4)
    )
    at = unloaded.points
    poses = pose_columns([at.points], [at.normals], unloaded.frame.centre_mm, *unloaded.pose_sd)
    stays = unloaded.noise.nugget_mm**2 * np.eye(len(once)) + poses @ poses.T
    np.testing.assert_allclose(often - stays, (once - stays) / 4, atol=1e-12)


def test_plan_reports_an_unsupported_body(sliding: World, tmp_path: Path) -> None:
    """A tilt across the breast pushes it out sideways, unless springs hold the chest wall."""
    tilt = [effect("plate_tilt")]
    assert loose([sliding[2][LOW]], tilt) == tilt
    held = world(tmp_path / "case", [at_force(6)], [LOW])
    assert loose([held[2][LOW]], SUSPECTS) == []


def test_more_data_do_not_hide_a_visible_effect(sliding: World) -> None:
    found = chance(sliding, Design((LOW,)))
    assert "plate_force" in np.array(found.names)[found.hidden]
    loud = replace(found, evidence=np.full(len(found.names), 100.0))
    assert "plate_force" in np.array(found.names)[loud.hidden]
    assert not replace(loud, shown=frozenset(found.names)).hidden.any()


def test_plan_omits_effects_that_do_not_act(sliding: World) -> None:
    assert "skin_scaled" not in chance(sliding, Design((LOW,))).names


# The record


def test_plan_ranks_further_measurements(sliding: World) -> None:
    unloaded, states, found = sliding
    told = make_plan("small", unloaded, states, found, SUSPECTS)
    assert told.scans == ("6 N", "18 N")
    assert told.without_columns == ("skin_scaled",)
    assert set(told.not_simulated) == {s.name for n, s in enumerate(states) if n not in found}
    names = [a.name for a in told.acquisitions]
    assert (
        set(names)
        == set(designs(unloaded, states, found))
        == {
            "a view, 18 N along x",
            "a second segmentation of every scan",
            "the plates' distance to 0.5 mm",
            "E_fat measured separately to 10 %",
        }
    )
    gained = [a.more_told_apart for a in told.acquisitions]
    assert gained == sorted(gained, reverse=True)
    assert all(a.minimum_ratio <= 1 + 1e-9 for a in told.acquisitions)
    offset = next(e for e in told.effects if e.name == "plate_tilt")
    assert [p.unit for p in offset.parameters] == ["deg", "deg"]
    assert {e.name for e in told.effects if not e.seen} == set(told.silent)


def test_plates_at_a_given_distance_have_no_force_effect(tmp_path: Path) -> None:
    unloaded, states, found = world(tmp_path / "case", [at_distance(42)], [0])
    told = make_plan("small", unloaded, states, found, SUSPECTS)
    assert "plate_force" in told.without_columns
    assert not any("plates' distance" in a.name for a in told.acquisitions)
    load = states[0].problem({"E_fat": 0.01, "E_gl": 0.03}).load
    assert isinstance(load, DistanceControl)
    assert load.upper_mm - load.lower_mm == pytest.approx(42)
    assert found[0].nominal[-1] == pytest.approx(np.zeros(2), abs=0.02)


# Loads that could be added

NODES_MM = np.array([[-20.0, -30.0, 0.0], [20.0, 30.0, 0.0], [0.0, 0.0, 40.0]])
DIAGONAL = (0.5**0.5, 0.5**0.5, 0.0)


def test_rotated_plates_start_at_the_ends_of_the_body() -> None:
    load = turned_to(ForceControl(10, -31, 31), (1, 0, 0), NODES_MM)
    assert isinstance(load, ForceControl)
    assert (load.lower_mm, load.upper_mm, load.force_n) == (-20, 20, 10)
    assert load.device.axis == (1, 0, 0)
    half = turned_to(DistanceControl(-15, 15), DIAGONAL, NODES_MM)
    assert isinstance(half, DistanceControl)
    reach = 50 / 2**0.5
    assert (half.lower_mm, half.upper_mm) == pytest.approx((-reach / 2, reach / 2))


def test_a_heavier_load_doubles_the_force_or_brings_the_plates_closer() -> None:
    twice = pressed_by(ForceControl(10, -31, 31), 2.0, NODES_MM)
    assert isinstance(twice, ForceControl)
    assert twice.force_n == 20
    closer = pressed_by(DistanceControl(-20, 20), 0.5, NODES_MM)
    assert isinstance(closer, DistanceControl)
    assert (closer.lower_mm, closer.upper_mm) == (-25, 25)


def test_wall_holds_a_rotated_body_with_its_larger_stiffness() -> None:
    wall = held_alike(Wall((False, False, True), (2e-4, 1e-6, 0.0)))
    assert wall == Wall((False, False, True), (2e-4, 2e-4, 0.0))


def test_candidates_do_not_include_a_planned_view(tmp_path: Path) -> None:
    along_x = at_force(8) | {"axis": "x", "lower_mm": -45, "upper_mm": 45}
    acquisition = acquisition_of(
        read_case(write_meant(tmp_path / "case", [at_force(8), along_x]), loaded=False)
    )
    unloaded = inverse_problem_of(acquisition, NODES, SPACING_MM)
    states = candidate_loads(acquisition, unloaded.frame, unloaded.model.finest.nodes)
    assert [s.kind for s in states] == ["planned", "planned", "load", "load", "view"]
    assert [s.name for s in states[2:]] == ["4 N", "16 N", "8 N along 45 degrees"]


def test_the_reference_scan_is_needed(tmp_path: Path) -> None:
    folder = write_meant(tmp_path / "case", [at_force(8)])
    (folder / "rest.nrrd").unlink()
    with pytest.raises(InputError, match=r"names rest\.nrrd, which is neither in the folder"):
        read_case(folder, loaded=False)

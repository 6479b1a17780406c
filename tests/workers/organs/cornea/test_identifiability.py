"""Identifiability of the constants, against the inventory and against refits."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.workers.organs.cornea.constant_doubts import profile_of
from palpate.workers.organs.cornea.cornea_problem import Candidate, prepare, scale_of
from palpate.workers.organs.cornea.corneal_model import (
    MPA_PER_MMHG,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.identifiability import (
    MODEL_ERROR,
    FittedContour,
    Information,
    attained_stretches,
    fitted_contour,
    information_of,
    information_of_pressures,
    pixel_rounding,
    shear_modulus_bound,
    stepped,
    stress_curve,
    uniaxial_stress_mpa,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import solve_prepared
from palpate.workers.organs.cornea.section_mesh import mesh_section
from palpate.workers.organs.cornea.section_outline import generated_section

LOAD = CorneaLoad(10.5 * MPA_PER_MMHG)


def eye(elements: int, constants: CorneaConstants) -> Candidate:
    mesh = mesh_section(generated_section(), elements, (-1.5, 0.0, 1.5))
    return Candidate(prepare(mesh, CorneaModel()), constants, LOAD)


X1 = eye(960, CorneaConstants((0.011, 0.035), (30.0, 80.0)))


@pytest.fixture(scope="module")
def contour() -> FittedContour:
    made = fitted_contour(X1)
    assert made is not None
    return made


@pytest.fixture(scope="module")
def information(contour: FittedContour) -> Information:
    return information_of(X1, contour)


def test_singular_values_and_bounds_match_the_inventory(information: Information) -> None:
    """For X1 at 112.5 mmHg: 834, 7.6, 0.135 and 0.0094 um; 10, 56, 9 and 1.9 % at 2 um pixels."""
    assert information.singular_values_um == pytest.approx((834, 7.6, 0.135, 0.0094), rel=0.05)
    bounds = 100 * information.bounds(pixel_rounding(2.0))
    assert bounds == pytest.approx((10, 56, 9, 1.9), rel=0.07)
    assert (information.bounds(MODEL_ERROR) > 1).all()
    assert shear_modulus_bound(X1.constants, information, pixel_rounding(2.0)) < 0.01


def test_bound_equals_the_scatter_of_linear_fits(information: Information) -> None:
    """Refits of one combination to noisy contours scatter by its bound."""
    noise = pixel_rounding(2.0)
    gram = information.gram_um2_mm[:1, :1]
    one = Information(information.names[:1], information.values[:1], gram, information.length_mm)
    pieces = round(information.length_mm / noise.correlation_mm)
    column = np.full(pieces, np.sqrt(gram[0, 0] / information.length_mm))
    rng = np.random.default_rng(1)
    errors = rng.normal(0, noise.sd_um, (400, pieces))
    fits = errors @ column / (column @ column)
    assert fits.std() == pytest.approx(one.bounds(noise)[0], rel=0.1)


def test_several_pressures_give_more_information_than_one(information: Information) -> None:
    noise = pixel_rounding(2.0)
    several = information_of_pressures(X1, (0.25, 0.5, 0.75, 1.0))
    assert several is not None
    assert (several.bounds(noise) < 0.5 * information.bounds(noise)).all()
    twice = information_of_pressures(X1, (1.0, 1.0))
    assert twice is not None
    assert twice.bounds(noise) == pytest.approx(information.bounds(noise) / np.sqrt(2), rel=1e-3)


def test_contour_is_limited_to_the_window(contour: FittedContour) -> None:
    half = fitted_contour(X1, (-20.0, 0.0))
    assert half is not None
    assert half.length_mm.sum() == pytest.approx(contour.length_mm.sum() / 2, rel=0.01)


def test_stress_of_exponent_two_is_neo_hookean() -> None:
    stretch = np.array([0.9, 1.0, 1.1])
    stress = uniaxial_stress_mpa(CorneaConstants((0.5,), (2.0,)), stretch)
    assert stress == pytest.approx(0.5 * (stretch**2 - 1 / stretch))


def test_stress_interval_widens_beyond_attained_stretches(information: Information) -> None:
    noise = pixel_rounding(2.0)
    curve = stress_curve(X1.constants, information, noise, np.array([1.0, 1.04, 1.2]))
    assert curve.sd_mpa[0] == 0
    relative = curve.sd_mpa[1:] / curve.stress_mpa[1:]
    assert relative[0] < 0.01
    assert relative[1] > 3 * relative[0]


def test_attained_stretches_equal_a_uniform_stretch() -> None:
    u = 0.02 * X1.prepared.mesh.nodes_mm
    assert attained_stretches(X1, u) == pytest.approx((1.02, 1.02))


def test_profile_is_below_the_misfit_without_refitting() -> None:
    small = eye(240, X1.constants)
    contour = fitted_contour(small)
    assert contour is not None
    steps = np.array([-0.02, 0.0, 0.02])
    solution = solve_prepared(small.prepared, small.constants, small.load)
    profile = profile_of(small, solution.displacement_mm, "mu2_mpa", steps)
    assert profile.misfit_um[1] == pytest.approx(0.0, abs=1e-3)
    mm = contour.length_mm / contour.length_mm.sum()
    alone = 0.02 * np.sqrt(mm @ contour.shift_um[:, 2] ** 2)
    assert (profile.misfit_um[[0, 2]] < 0.02 * alone).all()


def test_profile_follows_the_valley() -> None:
    """A far value of alpha2 is no worse than its bound, beyond which the model is not linear."""
    small = eye(240, X1.constants)
    solution = solve_prepared(small.prepared, small.constants, small.load)
    profile = profile_of(small, solution.displacement_mm, "alpha2", np.log([1.0, 1.1, 1.4]))
    assert (profile.misfit_um < 0.05).all()


def test_step_of_the_logarithm_multiplies_a_constant() -> None:
    name = "alpha2"
    moved = stepped(X1, {name: np.log(1.1)})
    assert scale_of(moved, name) == pytest.approx(88.0)


def test_diverging_candidate_has_no_contour() -> None:
    soft = replace(X1, constants=CorneaConstants((2e-5,), (2.0,)))
    assert fitted_contour(soft) is None

"""Stress against closed forms and the energy, and tangent against differences."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.organs.cornea.corneal_model import CorneaConstants
from palpate.workers.organs.cornea.corneal_ogden import (
    AXISYMMETRIC,
    PLANE_STRAIN,
    PLANE_STRESS,
    second_piola,
)
from tests.workers.organs.cornea.solver.ogden_energy import nominal_stress

KINDS = {"plane stress": PLANE_STRESS, "plane strain": PLANE_STRAIN, "axisymmetric": AXISYMMETRIC}
CONVENTIONS = ("mu/alpha", "2mu/alpha^2", "mu/alpha^2")
X1 = {"mu_mpa": (0.011, 0.035), "alpha": (30.0, 80.0)}
# Far apart, close and very close to each other, equal, and at rest.
STRETCHES = [(1.03, 0.98), (1.02, 1.0199), (1.02, 1.02 + 1e-6), (1.01, 1.01), (1.0, 1.0)]


def stress_and_tangent(C, log3, constants, kind, stiffness=1.0):
    S, D = np.empty(4), np.empty((4, 4))
    q = np.empty((len(constants.alpha), 3))
    law = constants.law()
    C12 = C[0, 1]
    J = second_piola(C[0, 0], C[1, 1], C12, np.exp(log3), law, stiffness, kind, True, q, S, D)
    alone, scratch = np.empty(4), np.empty((4, 4))
    second_piola(
        C[0, 0], C[1, 1], C12, np.exp(log3), law, stiffness, kind, False, q, alone, scratch
    )
    np.testing.assert_array_equal(S, alone)
    return S, D, np.log(J / np.sqrt(np.linalg.det(C)))


def turned(squares, angle):
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R @ np.diag(squares) @ R.T


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_uniaxial_tension_of_a_bar_matches_the_closed_form(convention, order):
    """tau = sum m (l^a - l^(-a/2)), with the moduli m in the convention mu/alpha."""
    mu, alpha = (0.011, 0.035, 0.02)[:order], (12.0, 20.0, -6.0)[:order]
    if order == 3 and convention == "mu/alpha":
        mu = (0.011, 0.035, -0.02)
    constants = CorneaConstants(mu, alpha, bulk_mpa=1e6, convention=convention)
    for stretch in (0.9, 1.05, 1.2):
        C = np.diag([stretch**2, 1 / stretch])
        S, _, e3 = stress_and_tangent(C, 0.0, constants, PLANE_STRESS)
        terms = zip(constants.moduli_mpa, alpha, strict=True)
        expected = sum(m * (stretch**a - stretch ** (-a / 2)) for m, a in terms)
        assert S[0] * stretch**2 == pytest.approx(expected, rel=1e-5)
        assert abs(S[1] / stretch) < 1e-5 * abs(expected)
        assert np.exp(e3) == pytest.approx(stretch**-0.5, rel=1e-5)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_equibiaxial_tension_of_a_sheet_matches_the_closed_form(convention):
    """tau = sum m (l^a - l^(-2 a)) in both directions."""
    constants = CorneaConstants((0.011, 0.035), (12.0, 20.0), 1e6, convention)
    for stretch in (0.93, 1.04, 1.1):
        S, _, e3 = stress_and_tangent(np.eye(2) * stretch**2, 0.0, constants, PLANE_STRESS)
        terms = zip(constants.moduli_mpa, constants.alpha, strict=True)
        expected = sum(m * (stretch**a - stretch ** (-2 * a)) for m, a in terms)
        assert S[:2] * stretch**2 == pytest.approx(expected, rel=1e-5)
        assert np.exp(e3) == pytest.approx(stretch**-2, rel=1e-5)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pair", STRETCHES)
def test_stress_is_the_slope_of_the_energy(kind, convention, pair):
    constants = CorneaConstants(**X1, convention=convention)
    log3 = 0.012 if kind == "axisymmetric" else 0.0
    for angle in (0.0, 0.4, 2.0):
        C = turned(np.square(pair), angle)
        S, _, e3 = stress_and_tangent(C, log3, constants, KINDS[kind])
        stretches = np.array([*pair, np.exp(e3)])
        nominal = nominal_stress(stretches, constants)
        expected = turned(nominal[:2] / pair, angle)
        np.testing.assert_allclose(
            [S[0], S[1], S[2]], [expected[0, 0], expected[1, 1], expected[0, 1]], atol=2e-14
        )
        assert S[3] == pytest.approx(nominal[2] / stretches[2], abs=2e-14)
        if kind == "plane stress":
            assert abs(nominal[2]) < 1e-14


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pair", STRETCHES)
def test_tangent_is_the_slope_of_the_stress(kind, convention, pair):
    """By five-point differences, also for equal principal stretches."""
    constants = CorneaConstants(**X1, convention=convention)
    log3 = 0.012 if kind == "axisymmetric" else 0.0
    C = turned(np.square(pair), 0.4)
    _, D, _ = stress_and_tangent(C, log3, constants, KINDS[kind], stiffness=1.3)
    # Of E11, E22, 2 E12 and E33; C is twice the strain.
    directions = [np.diag([2.0, 0.0]), np.diag([0.0, 2.0]), np.array([[0.0, 1.0], [1.0, 0.0]])]
    h = 1e-4

    def at(k, step):
        if k < 3:
            turned_C = C + step * directions[k]
            return stress_and_tangent(turned_C, log3, constants, KINDS[kind], 1.3)[0]
        square3 = np.exp(2 * log3) + 2 * step
        return stress_and_tangent(C, np.log(square3) / 2, constants, KINDS[kind], 1.3)[0]

    for k in range(4 if kind == "axisymmetric" else 3):
        slope = (8 * (at(k, h) - at(k, -h)) - (at(k, 2 * h) - at(k, -2 * h))) / (12 * h)
        rows = 4 if kind == "axisymmetric" else 3
        error = np.abs(slope[:rows] - D[:rows, k]).max()
        assert error < 1e-7 * np.abs(D).max()


def test_isochoric_stress_matches_the_other_ogden_law():
    """Against `mechanics.materials.ogden` at constant volume, where p vanishes."""
    constants = CorneaConstants(**X1)
    stretches = np.array([1.03, 0.985, 1 / (1.03 * 0.985)])
    F = np.diag(stretches)
    nominal = np.diag(Ogden(constants.mu_mpa, constants.alpha).stress(F))
    law_log3 = np.log(stretches[2])
    S, _, _ = stress_and_tangent(np.diag(stretches[:2] ** 2), law_log3, constants, AXISYMMETRIC)
    np.testing.assert_allclose(S[[0, 1, 3]], nominal / stretches, rtol=1e-10, atol=1e-13)


def test_small_strains_give_youngs_modulus_in_plane_stress():
    constants = CorneaConstants(**X1)
    _, D, _ = stress_and_tangent(np.eye(2), 0.0, constants, PLANE_STRESS)
    G, K = constants.shear_modulus_mpa, constants.bulk_mpa
    E, nu = 9 * K * G / (3 * K + G), (3 * K - 2 * G) / (2 * (3 * K + G))
    expected = E / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
    np.testing.assert_allclose(D[:3, :3], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"mu_mpa": (0.01,), "alpha": (30.0, 80.0)}, "one exponent alpha for every modulus"),
        ({"mu_mpa": (0.01,), "alpha": (0.0,)}, "exponents of an Ogden law must not be 0"),
        ({"mu_mpa": (-0.01,), "alpha": (30.0,)}, "positive shear and bulk modulus"),
        ({"mu_mpa": (float("nan"),), "alpha": (30.0,)}, "finite"),
        ({"mu_mpa": (0.01,), "alpha": (30.0,), "bulk_mpa": 0.0}, "positive shear and bulk"),
        ({"mu_mpa": (0.01,), "alpha": (30.0,), "convention": "ansys"}, "Ogden conventions are"),
    ],
)
def test_rejects_invalid_constants(bad, message):
    with pytest.raises(InputError, match=message):
        CorneaConstants(**bad)

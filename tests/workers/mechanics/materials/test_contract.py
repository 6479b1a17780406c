"""Contract of elastic laws, tested for every law.

Derivatives are checked to rounding by the complex step where the code is analytic.
Ogden's law uses eigenvectors, which are not; it is checked by differences of fourth order.
"""

import numpy as np
import pytest

from palpate.workers.mechanics.materials.ogden import Ogden
from tests.workers.mechanics.materials.laws_at_hand import (
    FIBRES,
    ISOCHORIC,
    assert_close,
    complex_step,
    deformations,
    differences,
    rotation,
)

LAWS = ISOCHORIC | FIBRES
F = deformations()


def of(*laws: dict):
    """Run a test for each of these laws."""
    named = {name: law for group in laws for name, law in group.items()}
    return pytest.mark.parametrize("law", named.values(), ids=named.keys())


def derivative(law, f, F):
    """Return the most accurate derivative available for a law, and its tolerance."""
    if isinstance(law, Ogden):
        return differences(f, F), 1e-8
    return complex_step(f, F), 1e-12


def stiffness(law) -> float:
    return law.shear_modulus_mpa if hasattr(law, "shear_modulus_mpa") else law.eta_mpa


@of(LAWS)
def test_stress_is_the_derivative_of_the_energy(law):
    expected, tolerance = derivative(law, law.energy, F)
    assert_close(law.stress(F), expected, tolerance, stiffness(law))


@of(LAWS)
def test_tangent_is_the_derivative_of_the_stress(law):
    # Slack fibres have no derivative at their kink, such as at rest.
    points = F[2:] if getattr(law, "tension_only", False) else F
    expected, tolerance = derivative(law, law.stress, points)
    assert_close(law.tangent(points), expected, tolerance, stiffness(law))


@of(LAWS)
def test_tangent_is_symmetric(law):
    A = law.tangent(F)
    assert_close(A, np.einsum("nkLiJ->niJkL", A), 1e-14, stiffness(law))


@of(LAWS)
def test_rotation_rotates_the_stress_and_keeps_the_energy(law):
    for seed in range(5):
        Q = rotation(seed)
        assert_close(law.energy(Q @ F), law.energy(F), 1e-12, stiffness(law))
        assert_close(law.stress(Q @ F), Q @ law.stress(F), 1e-12, stiffness(law))


@of(ISOCHORIC)
def test_law_is_isotropic(law):
    Q = rotation(3)
    assert_close(law.energy(F @ Q), law.energy(F), 1e-12, stiffness(law))
    assert_close(law.stress(F @ Q), law.stress(F) @ Q, 1e-12, stiffness(law))


@of(LAWS)
def test_energy_and_stress_are_zero_at_rest(law):
    for rest in (np.eye(3), rotation(4)):
        assert abs(law.energy(rest)) < 1e-14 * stiffness(law)
        np.testing.assert_allclose(law.stress(rest), 0, atol=1e-14 * stiffness(law))


@of(ISOCHORIC)
def test_small_strains_recover_linear_elasticity(law):
    """At rest ``A = mu0 (d_ik d_jl + d_il d_jk - 2/3 d_ij d_kl)``, from its definition."""
    d = np.eye(3)
    A = np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    A -= 2 / 3 * np.einsum("ij,kl->ijkl", d, d)
    mu = law.shear_modulus_mpa
    np.testing.assert_allclose(law.tangent(d), mu * A, rtol=0, atol=1e-12 * mu)


@of(ISOCHORIC)
def test_stress_deviates_from_linear_elasticity_at_second_order(law):
    H = np.random.default_rng(1).uniform(-1, 1, (3, 3))
    strain = (H + H.T) / 2
    linear = 2 * law.shear_modulus_mpa * (strain - np.trace(strain) / 3 * np.eye(3))
    sizes = np.array([1e-3, 5e-4, 2.5e-4])
    errors = [np.abs(law.stress(np.eye(3) + h * H) - h * linear).max() for h in sizes]
    orders = np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert orders == pytest.approx(2, abs=0.05)


@of(ISOCHORIC, {name: law for name, law in FIBRES.items() if law.isochoric})
def test_volume_change_has_no_energy(law):
    size = stiffness(law)
    for s in (0.3, 0.9, 4.0):
        assert_close(law.energy(s * F), law.energy(F), 1e-12, size)
        assert_close(law.stress(s * F), law.stress(F) / s, 1e-12, size)
        assert_close(law.tangent(s * F), law.tangent(F) / s**2, 1e-12, size)
    P = law.stress(F)
    assert_close(np.einsum("niJ,niJ->n", P, F), np.zeros(len(F)), 1e-12, np.abs(P).max())
    # and, derived once more: A : F = -P
    assert_close(np.einsum("niJkL,nkL->niJ", law.tangent(F), F), -P, 1e-12, np.abs(P).max())


@of(ISOCHORIC, {name: law for name, law in FIBRES.items() if law.isochoric})
def test_inverted_points_are_nan_and_affect_no_others(law):
    bad = np.stack([F[20], np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    for f in (law.energy, law.stress, law.tangent):
        values = f(bad)
        assert np.isnan(values[1:]).all()
        np.testing.assert_allclose(values[0], f(F[20]), rtol=1e-13)


@of(LAWS)
def test_keeps_leading_axes_and_the_input(law):
    stack = F[:12].reshape(4, 3, 3, 3).copy()
    for f, shape in ((law.energy, ()), (law.stress, (3, 3)), (law.tangent, (3, 3, 3, 3))):
        values = f(stack)
        assert values.shape == (4, 3, *shape)
        assert f(stack[0, 0]).shape == shape
        np.testing.assert_allclose(values[3, 1], f(stack[3, 1]), rtol=1e-12, atol=1e-18)
        assert f(stack[:0]).shape == (0, 3, *shape)
    np.testing.assert_array_equal(stack.reshape(12, 3, 3), F[:12])


# With c10 < 0 Mooney's energy is negative in strong tension, as it should be.
@of({name: law for name, law in ISOCHORIC.items() if name != "mooney-of-brain"})
def test_energy_is_positive_off_rest(law):
    changed = np.ptp(np.linalg.svd(F, compute_uv=False), axis=1) > 1e-3
    assert changed.sum() > 30
    assert (law.energy(F[changed]) > 0).all()

"""Stress in laboratory tests, against the formulas of Rivlin and Ogden.

For a law W(I1, I2) with slopes W1 and W2 (Rivlin 1948), and for Ogden's (Ogden 1972)::

    uniaxial      P = 2 (l - l^-2) (W1 + W2 / l)      sum mu (l^(a-1) - l^(-a/2-1))
    equibiaxial   P = 2 (l - l^-5) (W1 + W2 l^2)      sum mu (l^(a-1) - l^(-2a-1))
    planar        P = 2 (l - l^-3) (W1 + W2)          sum mu (l^(a-1) - l^(-a-1))
    simple shear  P = 2 g (W1 + W2)
"""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.law_fit import (
    DeformationMode,
    StressTable,
    deformation_gradient,
    nominal_stress_mpa,
)
from palpate.workers.mechanics.materials.ogden import Ogden
from tests.workers.mechanics.materials.laws_at_hand import ISOCHORIC

L = np.linspace(0.5, 3, 26)
RIVLIN = {
    DeformationMode.UNIAXIAL: lambda l: (2 * (l - l**-2), 2 * (l - l**-2) / l),
    DeformationMode.EQUIBIAXIAL: lambda l: (2 * (l - l**-5), 2 * (l - l**-5) * l**2),
    DeformationMode.PLANAR: lambda l: (2 * (l - l**-3), 2 * (l - l**-3)),
    DeformationMode.SIMPLE_SHEAR: lambda g: (2 * g, 2 * g),
}
INVARIANTS = {
    DeformationMode.UNIAXIAL: lambda l: (l**2 + 2 / l, 2 * l + l**-2),
    DeformationMode.EQUIBIAXIAL: lambda l: (2 * l**2 + l**-4, l**4 + 2 * l**-2),
    DeformationMode.PLANAR: lambda l: (l**2 + l**-2 + 1, l**2 + l**-2 + 1),
    DeformationMode.SIMPLE_SHEAR: lambda g: (3 + g**2, 3 + g**2),
}
SLOPES = {
    "neo-hookean": lambda x, y: (0.0015, 0.0),
    "mooney": lambda x, y: (0.16, 0.05),
    "mooney-rivlin-5": lambda x, y: (0.2 + 0.6 * x - 0.25 * y, 0.1 - 0.25 * x + 0.3 * y),
    "yeoh-of-rubber": lambda x, y: (0.175 - 1.5e-3 * x + 9.9e-5 * x**2, 0.0),
    "fung-soft": lambda x, y: (0.01 * np.exp(0.1 * x), 0.0),
}


@pytest.mark.parametrize("mode", DeformationMode)
@pytest.mark.parametrize("name", SLOPES)
def test_laws_of_invariants_match_rivlin(name, mode):
    I1, I2 = INVARIANTS[mode](L)
    w1, w2 = SLOPES[name](I1 - 3, I2 - 3)
    a, b = RIVLIN[mode](L)
    stress = nominal_stress_mpa(ISOCHORIC[name], mode, L)
    np.testing.assert_allclose(stress, a * w1 + b * w2, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize(
    ("mode", "power"),
    [
        (DeformationMode.UNIAXIAL, -0.5),
        (DeformationMode.EQUIBIAXIAL, -2.0),
        (DeformationMode.PLANAR, -1.0),
    ],
)
def test_ogden_matches_the_closed_forms(mode, power):
    law = ISOCHORIC["ogden-treloar"]
    terms = zip(law.mu_mpa, law.alpha, strict=True)
    expected = sum(mu * (L ** (a - 1) - L ** (power * a - 1)) for mu, a in terms)
    np.testing.assert_allclose(nominal_stress_mpa(law, mode, L), expected, rtol=1e-11, atol=1e-15)


def test_ogden_in_simple_shear_matches_the_closed_form():
    """P = dW/dg with stretches l, 1/l, l - 1/l = g, and so dl/dg = l^2 / (1 + l^2)."""
    g, mu, alpha = np.linspace(-0.5, 0.5, 11), 2.0, -7.0
    l = g / 2 + np.sqrt(1 + g**2 / 4)
    expected = -mu * (l ** (alpha - 1) - l ** (-alpha - 1)) * l**2 / (1 + l**2)
    stress = nominal_stress_mpa(Ogden((-mu,), (alpha,)), DeformationMode.SIMPLE_SHEAR, g)
    np.testing.assert_allclose(stress, expected, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("mode", DeformationMode)
@pytest.mark.parametrize("name", ISOCHORIC)
def test_work_of_the_load_equals_the_energy(name, mode):
    """dW(F(l))/dl equals the load P, or twice P if it pulls in two directions."""
    law, h = ISOCHORIC[name], 1e-5
    l = np.linspace(0.7, 1.5, 9)
    W = [law.energy(deformation_gradient(mode, l + s * h)) for s in (-1, 1)]
    power = (W[1] - W[0]) / (2 * h) / (2 if mode is DeformationMode.EQUIBIAXIAL else 1)
    stress = nominal_stress_mpa(law, mode, l)
    np.testing.assert_allclose(stress, power, atol=1e-7 * np.abs(power).max())


@pytest.mark.parametrize("mode", DeformationMode)
def test_specimen_keeps_its_volume(mode):
    np.testing.assert_allclose(np.linalg.det(deformation_gradient(mode, L)), 1, rtol=1e-14)


@pytest.mark.parametrize(
    ("stretch", "stress", "words"),
    [
        ([1.0, 1.1], [0.0], r"as many stresses as deformations, got shapes \(1,\) and \(2,\)"),
        ([1.0, np.nan], [0.0, 1.0], "finite"),
        ([1.0, 1.1], [0.0, 0.0], "a stress other than zero"),
        ([-0.1, 0.1], [-1.0, 1.0], "stretches above zero, got -0.1.* not the strain"),
    ],
)
def test_rejects_invalid_tables(stretch, stress, words):
    with pytest.raises(InputError, match=words):
        StressTable(DeformationMode.UNIAXIAL, np.array(stretch), np.array(stress))


def test_shear_may_be_negative():
    assert (
        StressTable(DeformationMode.SIMPLE_SHEAR, np.array([-0.1]), np.array([-2.0])).rms_mpa == 2.0
    )

"""Limits and invalid constants of individual laws."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin, NeoHookean, Yeoh
from tests.workers.mechanics.materials.laws_at_hand import assert_close, deformations, rotation

F = deformations()

# Two forms of one law without common code: powers of stretches, invariants.
PAIRS = {
    "2 is neo-Hookean": (Ogden((0.3,), (2.0,)), NeoHookean(0.3)),
    "2 and -2 are Mooney": (Ogden((0.4, -0.1), (2.0, -2.0)), MooneyRivlin(0.2, 0.05)),
    "4": (Ogden((0.3,), (4.0,)), MooneyRivlin(0.45, -0.15, 0.075)),
    "Yeoh of one": (Yeoh(0.15), NeoHookean(0.3)),
    "Yeoh of two": (Yeoh(0.15, 0.07), MooneyRivlin(0.15, c20_mpa=0.07)),
    "split terms": (Ogden((0.1, 0.2), (2.0, 2.0)), NeoHookean(0.3)),
}


@pytest.mark.parametrize(("one", "other"), PAIRS.values(), ids=PAIRS.keys())
def test_equivalent_laws_agree(one, other):
    r"""With alpha = 4: tr C^2 - 3 = I1^2 - 2 I2 - 3 = x^2 + 6 x - 2 y."""
    assert one.shear_modulus_mpa == pytest.approx(other.shear_modulus_mpa, rel=1e-14)
    for name in ("energy", "stress", "tangent"):
        assert_close(getattr(one, name)(F), getattr(other, name)(F), 1e-13, 1.0)


def test_fung_tends_to_neo_hookean_as_its_rate_vanishes():
    gaps = [np.abs(Fung(0.3, b).stress(F) - NeoHookean(0.3).stress(F)).max() for b in (1e-3, 1e-4)]
    assert gaps[0] / gaps[1] == pytest.approx(10, rel=0.01)


@pytest.mark.parametrize("alpha", [7.0, -19.0, 1.0])
def test_ogden_tangent_is_smooth_at_equal_stretches(alpha):
    """Rounding errors divided by the gap would grow as the gap shrinks."""
    law = Ogden((2 / alpha,), (alpha,))
    Q, R = rotation(1), rotation(2)
    met = law.tangent(Q @ np.diag([1.2, 1.2, 0.7]) @ R)
    size = np.abs(met).max()
    for gap in 10.0 ** -np.arange(2, 17):
        near = law.tangent(Q @ np.diag([1.2, 1.2 + gap, 0.7]) @ R)
        assert np.abs(near - met).max() < (30 * gap + 1e-13) * size


def test_small_strains_keep_full_precision():
    """Strains of 1e-8 give energies of 1e-16 of the modulus."""
    e = 1e-8
    F = np.diag([1 + e, 1.0, 1 / (1 + e)])
    exact = 2 * e**2  # mu (e1^2 + e3^2), mu = 2
    assert Ogden((2 / 1.5 * 2,), (1.5,)).energy(F) == pytest.approx(exact, rel=1e-6)


def test_conventions_of_ogden_agree():
    """One term of shear modulus 3 and exponent 5, in each program's convention."""
    ogden = Ogden.from_convention("ogden", (1.2,), (5.0,))
    abaqus = Ogden.from_convention("abaqus", (3.0,), (5.0,))
    febio = Ogden.from_convention("febio", (6.0,), (5.0,))
    assert ogden.mu_mpa == abaqus.mu_mpa == febio.mu_mpa == pytest.approx((1.2,))
    assert ogden.shear_modulus_mpa == pytest.approx(3.0)


def test_overstretched_fung_is_infinite_without_warnings():
    law = Fung(1.0, 100.0)
    assert law.energy(np.diag([5.0, 1.0, 0.2])) == np.inf
    law.stress(np.diag([5.0, 1.0, 0.2]))
    law.tangent(np.diag([5.0, 1.0, 0.2]))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: NeoHookean(-1.0), r"neo-Hookean law needs mu above zero, got mu = -1"),
        (lambda: NeoHookean(float("nan")), r"finite numbers, got NeoHookean\(mu_mpa=nan\)"),
        (lambda: MooneyRivlin(0.1, -0.2), r"needs c10 \+ c01 above zero, got c10 \+ c01 = -0.1"),
        (lambda: MooneyRivlin(0.1, c11_mpa=np.inf), "finite numbers"),
        (lambda: Yeoh(0.0), "needs c1 above zero"),
        (lambda: Yeoh(1.0, np.nan), "finite numbers"),
        (lambda: Fung(1.0, 0.0), "needs mu and b above zero, got mu = 1, b = 0"),
        (lambda: Ogden((1.0,), (1.0, 2.0)), "1 moduli and 2 exponents"),
        (lambda: Ogden((), ()), "0 moduli"),
        (lambda: Ogden((1.0,), (0.0,)), "exponents of an Ogden law must not be 0"),
        (lambda: Ogden((1.0,), (-2.0,)), r"sum\(mu alpha\)/2 above zero, got .* = -1 from"),
        (lambda: Ogden((1.0, np.inf), (1.0, 2.0)), "finite numbers"),
        (
            lambda: Ogden.from_convention("ansys", (1.0,), (2.0,)),
            "ogden, abaqus, febio; got 'ansys'",
        ),
        (
            lambda: Ogden.from_convention("abaqus", (1.0,), (0.0,)),
            "exponents of an Ogden law must not be 0",
        ),
    ],
)
def test_rejects_invalid_constants(make, words):
    with pytest.raises(InputError, match=words):
        make()

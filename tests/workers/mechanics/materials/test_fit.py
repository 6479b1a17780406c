"""Fits recover the law behind a table, or else find the best law."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials import law_plugins
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.law_fit import (
    DeformationMode,
    StressTable,
    fit,
    nominal_stress_mpa,
    relative_error,
)
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin, NeoHookean, Yeoh

STRETCH = np.linspace(0.7, 2.5, 15)
SHEAR = np.linspace(-0.4, 0.4, 8)


def tables_of(law, scale: float = 1.0, noise: float = 0.0) -> list[StressTable]:
    """Return tables of a law, one for each mode."""
    rng = np.random.default_rng(11)
    tables = []
    for mode in DeformationMode:
        x = SHEAR if mode is DeformationMode.SIMPLE_SHEAR else STRETCH
        stress = scale * nominal_stress_mpa(law, mode, x)
        tables.append(StressTable(mode, x, stress * (1 + noise * rng.uniform(-1, 1, x.size))))
    return tables


MADE = {
    "neo-hookean": (law_plugins.NEO_HOOKEAN_FAMILY, NeoHookean(0.0031)),
    "mooney-rivlin": (law_plugins.MOONEY_RIVLIN_FAMILY, MooneyRivlin(0.17, 0.03)),
    "mooney-rivlin-5": (
        law_plugins.MOONEY_RIVLIN_5_FAMILY,
        MooneyRivlin(0.16, 0.02, -4e-3, 1e-3, 2e-3),
    ),
    "yeoh": (law_plugins.YEOH_FAMILY, Yeoh(0.18, -4e-3, 2e-3)),
    "fung": (law_plugins.FUNG_FAMILY, Fung(0.0012, 0.37)),
    "ogden-1": (law_plugins.ogden_family(1), Ogden((-0.1,), (-6.3,))),
    "ogden-2": (law_plugins.ogden_family(2), Ogden((0.8, -0.02), (1.4, -5.2))),
    "ogden-3": (law_plugins.ogden_family(3), Ogden((0.85, 0.003, -1e-3), (0.77, 7.4, -6.2))),
}


@pytest.mark.parametrize(("family", "law"), MADE.values(), ids=MADE.keys())
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_recovers_the_law_of_the_tables(family, law, scale):
    """For any size of stress: tissue and rubber differ by a factor of a thousand."""
    fitted = fit(family, tables_of(law, scale))
    assert fitted.error < 1e-6
    assert type(fitted.law) is type(law)
    assert fitted.law.shear_modulus_mpa == pytest.approx(scale * law.shear_modulus_mpa, rel=1e-4)
    if isinstance(law, Ogden):
        assert sorted(fitted.law.alpha) == pytest.approx(sorted(law.alpha), rel=1e-3)


@pytest.mark.parametrize("name", ["mooney-rivlin", "mooney-rivlin-5", "yeoh", "fung"])
def test_recovers_named_coefficients(name):
    family, law = MADE[name]
    fitted = fit(family, tables_of(law)).coefficients
    for constant, value in fitted.items():
        assert value == pytest.approx(getattr(law, constant), rel=1e-5, abs=1e-9), constant


def test_neo_hookean_of_a_noisy_table_is_the_projection():
    """mu = sum(w g P) / sum(w g g) with g = l - l^-2 and so on, w the weight of the table."""
    tables = tables_of(Yeoh(0.18, -4e-3, 2e-3), noise=0.1)
    g = [STRETCH - STRETCH**-2, STRETCH - STRETCH**-5, STRETCH - STRETCH**-3, SHEAR]
    weight = [1 / np.sum(t.stress_mpa**2) for t in tables]
    over = sum(w * np.sum(x * t.stress_mpa) for w, x, t in zip(weight, g, tables, strict=True))
    under = sum(w * np.sum(x * x) for w, x in zip(weight, g, strict=True))
    fitted = fit(law_plugins.NEO_HOOKEAN_FAMILY, tables)
    assert fitted.law.shear_modulus_mpa == pytest.approx(over / under, rel=1e-10)


@pytest.mark.parametrize(
    "family", [law_plugins.YEOH_FAMILY, law_plugins.FUNG_FAMILY, law_plugins.ogden_family(1)]
)
def test_fit_is_a_local_minimum(family):
    tables = tables_of(MooneyRivlin(0.16, 0.02, 5e-3), noise=0.1)
    best = fit(family, tables)
    for name, value in best.coefficients.items():
        for factor in (0.99, 1.01):
            moved = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
            law = type(best.law)(**(best.coefficients | {name: moved}))
            errors = [relative_error(law, table) for table in tables]
            assert np.sqrt(np.mean(np.square(errors))) > best.error


def test_reports_the_error_of_each_table():
    """A law without error in shear, where x = y, but with errors in other modes."""
    tables = tables_of(MooneyRivlin(0.1, 0.1))
    errors = [relative_error(NeoHookean(0.4), table) for table in tables]
    assert errors[2:] == pytest.approx([0, 0], abs=1e-12)
    one = tables[0]
    expected = 0.2 * (STRETCH - STRETCH**-2) * (1 + 1 / STRETCH)
    residual = 0.4 * (STRETCH - STRETCH**-2) - expected
    by_hand = np.sqrt(np.sum(residual**2) / np.sum(expected**2))
    assert relative_error(NeoHookean(0.4), one) == pytest.approx(by_hand, rel=1e-10)
    fitted = fit(law_plugins.NEO_HOOKEAN_FAMILY, tables)
    assert fitted.error == pytest.approx(np.sqrt(np.mean(np.square(fitted.errors))))


def test_fit_is_deterministic():
    tables = tables_of(Yeoh(0.18, -4e-3, 2e-3), noise=0.05)
    assert fit(law_plugins.ogden_family(2), tables) == fit(law_plugins.ogden_family(2), tables)


def test_rejects_too_few_points():
    table = StressTable(
        DeformationMode.UNIAXIAL, np.array([1.0, 1.1, 1.2]), np.array([0.0, 0.1, 0.2])
    )
    with pytest.raises(InputError, match=r"Yeoh has 3 constants, but the tables have 2 points"):
        fit(law_plugins.YEOH_FAMILY, [table])
    with pytest.raises(InputError, match="have 0 points"):
        fit(law_plugins.NEO_HOOKEAN_FAMILY, [])


@pytest.mark.parametrize(
    "family",
    [
        law_plugins.NEO_HOOKEAN_FAMILY,
        law_plugins.MOONEY_RIVLIN_FAMILY,
        law_plugins.FUNG_FAMILY,
        law_plugins.ogden_family(1),
    ],
)
def test_rejects_compression_without_its_sign(family):
    table = StressTable(
        DeformationMode.UNIAXIAL, np.array([0.9, 0.8, 0.7]), np.array([0.1, 0.2, 0.3])
    )
    with pytest.raises(InputError, match="zero stiffness at rest"):
        fit(family, [table])


def test_rejects_per_cent_instead_of_stretch():
    table = StressTable(
        DeformationMode.UNIAXIAL, np.linspace(1e5, 1e6, 9), np.linspace(0.1, 0.9, 9)
    )
    with pytest.raises(InputError, match="too large for Fung"):
        fit(law_plugins.FUNG_FAMILY, [table])


@pytest.mark.parametrize("terms", [0, 5])
def test_rejects_other_numbers_of_terms(terms):
    with pytest.raises(InputError, match=f"1 to 4 terms, got {terms}"):
        law_plugins.ogden_family(terms)

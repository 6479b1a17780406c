"""Moduli over parts of a table and from an offset, for tables with known moduli."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.law_fit import (
    DeformationMode,
    LawFit,
    StressTable,
    equally_good,
    fit_law,
    nominal_stress_mpa,
)
from palpate.workers.mechanics.materials.law_fit_range import from_offset, moduli_of_parts, slack_of
from palpate.workers.mechanics.materials.law_plugins import law_named, law_names
from tests.workers.mechanics.materials.test_tables import brain, rubber

MU = 0.004
PLUGINS = [law_named(name) for name in law_names()]
LAWS = ("neo-hookean", "mooney-rivlin", "yeoh", "fung", "ogden")


def made(
    name: str, shape: dict[str, float], mode: DeformationMode, strain: np.ndarray
) -> StressTable:
    rest = 0.0 if mode is DeformationMode.SIMPLE_SHEAR else 1.0
    law = law_named(name).make(MU, shape)
    return StressTable(mode, rest + strain, nominal_stress_mpa(law, mode, rest + strain))


def loosened(table: StressTable, slack: float) -> StressTable:
    """Return what a machine records if the specimen is first slack by a strain."""
    rest = 0.0 if table.mode is DeformationMode.SIMPLE_SHEAR else 1.0
    sign = np.sign((table.deformation - rest).sum())
    strain = (table.deformation - rest) * (1 + rest * sign * slack) + sign * slack
    start = sign * np.linspace(0, slack, 4)
    loaded = table.stress_mpa != 0
    return StressTable(
        table.mode,
        rest + np.concatenate([start, strain[loaded]]),
        np.concatenate([np.zeros(4), table.stress_mpa[loaded]]),
    )


def fits_of(*tables: StressTable) -> list[LawFit]:
    fits = []
    for name in LAWS:
        try:
            fits.append(fit_law(law_named(name), tables))
        except InputError:  # a law that cannot follow the table
            continue
    return fits


CASES = {
    "tension": (DeformationMode.UNIAXIAL, np.linspace(0.01, 0.4, 25)),
    "compression": (DeformationMode.UNIAXIAL, -np.linspace(0.01, 0.3, 25)),
    "sheet": (DeformationMode.EQUIBIAXIAL, np.linspace(0.01, 0.3, 25)),
    "shear": (DeformationMode.SIMPLE_SHEAR, np.linspace(0.01, 0.4, 25)),
}


@pytest.mark.parametrize("case", CASES)
def test_finds_the_slack_of_a_table_and_its_modulus(case):
    mode, strain = CASES[case]
    stated = made("fung", {"b": 2.0}, mode, strain)
    recorded = loosened(stated, 0.03)
    np.testing.assert_allclose(from_offset(recorded, 0.03).deformation[4:], stated.deformation)
    (slack,) = slack_of(PLUGINS, [recorded])
    assert slack.table == 0
    assert slack.offset == pytest.approx(0.03, abs=1e-3)
    assert slack.fit.shear_modulus_mpa == pytest.approx(MU, rel=0.03)
    assert list(slack_of(PLUGINS, [stated])) == []


def test_names_the_slack_one_of_two_tables():
    mode, strain = CASES["tension"]
    taut = made("neo-hookean", {}, mode, strain)
    loose = loosened(taut, 0.04)
    (slack,) = slack_of(PLUGINS, [taut, loose])
    assert slack.table == 1
    assert slack.offset == pytest.approx(0.04, abs=1e-3)


def test_a_table_with_both_signs_is_not_slack():
    mode, _ = CASES["shear"]
    table = made("fung", {"b": 9.0}, mode, np.linspace(-0.4, 0.4, 26))
    assert list(slack_of(PLUGINS, [table])) == []


@pytest.mark.parametrize("region", ["cortex", "corona_radiata", "corpus_callosum"])
def test_finds_the_slack_before_a_measured_table(region):
    """Brain in tension: not slack as measured; with slack added, its modulus is that without."""
    table = brain(region)[1]
    assert list(slack_of(PLUGINS, [table])) == []
    recorded = loosened(table, 0.03)
    (slack,) = slack_of(PLUGINS, [recorded])
    truth = equally_good(fits_of(table))[0].shear_modulus_mpa
    assert slack.offset == pytest.approx(0.03, abs=0.003)
    assert slack.fit.shear_modulus_mpa == pytest.approx(truth, rel=0.15)
    assert equally_good(fits_of(recorded))[0].shear_modulus_mpa < 0.5 * truth


@pytest.mark.parametrize("material", ["Treloar_1944", "Kawabata_1981", "Meunier_2008"])
def test_rubber_is_not_slack(material):
    tables = rubber(material)
    assert list(slack_of(PLUGINS, tables)) == []


def test_moduli_of_parts_agree_if_the_law_is_right():
    """A law of the table has one modulus; neo-Hooke on a table that stiffens has a range."""
    mode, strain = CASES["tension"]
    table = made("fung", {"b": 2.0}, mode, strain)
    right, wrong = (fit_law(law_named(name), [table]) for name in ("fung", "neo-hookean"))
    assert moduli_of_parts(right, [table]) == pytest.approx((MU, MU), rel=1e-4)
    low, high = moduli_of_parts(wrong, [table])
    first_half = table.deformation - 1 <= 0.2
    half = StressTable(mode, table.deformation[first_half], table.stress_mpa[first_half])
    assert low == fit_law(law_named("neo-hookean"), [half]).shear_modulus_mpa
    assert MU < low < wrong.shear_modulus_mpa < high


def test_too_few_points_have_no_parts():
    mode, _ = CASES["tension"]
    table = made("yeoh", {"c2": 0.5, "c3": 0.2}, mode, np.array([0.1, 0.2, 0.3]))
    assert moduli_of_parts(fit_law(law_named("yeoh"), [table]), [table]) is None

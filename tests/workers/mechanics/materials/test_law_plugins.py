"""Laws chosen by name in a file, and their fits to tables."""

from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.law_fit import (
    DeformationMode,
    StressTable,
    equally_good,
    fit_law,
    nominal_stress_mpa,
    read_tables,
)
from palpate.workers.mechanics.materials.law_plugins import (
    LawPlugin,
    law_named,
    law_names,
    law_of_constant,
)
from palpate.workers.mechanics.materials.polynomial_laws import NeoHookean
from palpate.workers.mechanics.model_parameters import NUMBER, Parameter
from palpate.workers.plugins import foreign_plugins
from tests.workers.mechanics.materials.laws_at_hand import deformations
from tests.workers.mechanics.materials.test_tables import rubber

MU = 0.004
SHAPES = {
    "neo-hookean": {},
    "mooney-rivlin": {"share2": 0.3},
    "yeoh": {"c2": 0.5, "c3": 0.2},
    "fung": {"b": 1.5},
    "ogden": {"alpha": -7.0},
    "ogden-2": {"alpha1": 5.0, "alpha2": -9.0, "share2": 0.4},
}


def made_by(plugin: LawPlugin, shape: dict[str, float], noise: float = 0.0) -> list[StressTable]:
    rng, law = np.random.default_rng(3), plugin.make(MU, shape)
    tables = []
    for mode in (DeformationMode.UNIAXIAL, DeformationMode.EQUIBIAXIAL, DeformationMode.PLANAR):
        x = np.linspace(0.8, 1.6, 12)
        stress = nominal_stress_mpa(law, mode, x)
        tables.append(StressTable(mode, x, stress * (1 + noise * rng.standard_normal(x.size))))
    return tables


def test_covers_every_built_in_law():
    foreign = {plugin.name for plugin in foreign_plugins() if plugin.group == "laws"}
    assert set(law_names()) - foreign == set(SHAPES), "each law needs its constants in SHAPES"


@pytest.mark.parametrize("name", SHAPES)
def test_neutral_shape_is_neo_hookean(name):
    F = deformations()
    law, expected = law_named(name).law(MU, {}), NeoHookean(MU)
    np.testing.assert_allclose(law.energy(F), expected.energy(F), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(law.stress(F), expected.stress(F), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_shape_does_not_change_the_stiffness_at_rest(name):
    plugin = law_named(name)
    law = plugin.make(MU, SHAPES[name])
    assert law.shear_modulus_mpa == pytest.approx(MU, rel=1e-12)
    twice = plugin.make(2 * MU, SHAPES[name])
    F = deformations()
    np.testing.assert_allclose(twice.energy(F), 2 * law.energy(F), rtol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_fit_recovers_the_shape(name):
    plugin = law_named(name)
    found = fit_law(plugin, made_by(plugin, SHAPES[name]))
    assert found.shear_modulus_mpa == pytest.approx(MU, rel=1e-3)
    again = plugin.make(found.shear_modulus_mpa, found.shape)
    F = deformations()[:6]
    law = plugin.make(MU, SHAPES[name])
    np.testing.assert_allclose(again.energy(F), law.energy(F), rtol=1e-2, atol=1e-9)
    assert set(found.constants) == {p.door_name for p in plugin.constants()}


def test_law_without_a_family_is_fitted_within_its_bounds():
    """As for plug-ins: shape constants are searched, the modulus is linear."""
    rate = Parameter("rate", NUMBER, 0.1, 8.0, 1.0, "rate")
    plugin = LawPlugin("mine", "Mine", (rate,), lambda mu, shape: Fung(mu, shape["rate"]))
    found = fit_law(plugin, made_by(plugin, {"rate": 2.5}))
    assert found.shape["rate"] == pytest.approx(2.5, rel=1e-4)
    assert found.constants == {"mine_rate": found.shape["rate"]}


def test_fewest_constants_win_among_equal_fits():
    tables = made_by(law_named("neo-hookean"), {}, noise=0.02)
    fits = [fit_law(law_named(name), tables) for name in ("yeoh", "neo-hookean", "ogden")]
    assert "neo-hookean" in {one.plugin.name for one in equally_good(fits)}
    best = equally_good(
        [
            fit_law(law_named(n), made_by(law_named("fung"), {"b": 2.0}, 0.01))
            for n in ("neo-hookean", "fung", "mooney-rivlin")
        ]
    )
    assert [one.plugin.name for one in best] == ["fung"]


def test_yeoh_but_not_neo_hooke_fits_treloars_rubber():
    fits = [fit_law(law_named(name), rubber("Treloar_1944")) for name in ("neo-hookean", "yeoh")]
    neo, yeoh = fits
    assert [one.plugin.name for one in equally_good(fits)] == ["yeoh"]
    assert yeoh.fit.error < 0.1 < neo.fit.error
    assert yeoh.shear_modulus_mpa == pytest.approx(0.35, abs=0.02)
    assert yeoh.constants["yeoh_c2"] < 0 < yeoh.constants["yeoh_c3"]


def test_finds_the_law_of_a_constant_by_its_name():
    for name in SHAPES:
        for tissue in ("", "fat"):
            for p in law_named(name).constants(tissue):
                assert law_of_constant(p.door_name) == name
    assert law_of_constant("E_fat_kpa") == ""
    with pytest.raises(InputError, match="did you mean 'yeoh'"):
        law_named("yeo")


def write(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


def test_reads_units_and_modes_of_a_table(tmp_path):
    text = "# made by hand\nstrain_percent;stress_kpa;mode\n10;2;\n20;5;planar\n\n30;7;Planar\n"
    uniaxial, planar = read_tables(write(tmp_path, text))
    assert uniaxial.mode is DeformationMode.UNIAXIAL
    assert planar.mode is DeformationMode.PLANAR
    np.testing.assert_allclose(uniaxial.deformation, [1.1])
    np.testing.assert_allclose(planar.deformation, [1.2, 1.3])
    np.testing.assert_allclose(planar.stress_mpa, [0.005, 0.007])
    (shear,) = read_tables(write(tmp_path, "shear,stress_pa\n0.1,30\n0.2,60\n"))
    assert shear.mode is DeformationMode.SIMPLE_SHEAR
    np.testing.assert_allclose(shear.stress_mpa, [3e-5, 6e-5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stretch,stress\n1.1,2\n", "stress_kpa"),
        ("stretch,strain,stress_kpa\n1.1,0.1,2\n", "one column of the deformation"),
        ("stretch,stress_kpa\n1.1,much\n", "line 2: stress_kpa is not a number, found 'much'"),
        ("stretch,stress_kpa\n1.1\n", "line 2: stress_kpa"),
        ("stretch,stress_kpa,mode\n1.1,2,shear\n", "uniaxial, equibiaxial, planar"),
        ("stretch,stress_kpa\n", "no rows"),
        ("", "found the columns none"),
        ("stretch,stress_kpa\n-1,2\n", "stretches above zero"),
    ],
)
def test_rejects_invalid_tables(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_tables(write(tmp_path, text))

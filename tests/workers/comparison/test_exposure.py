"""Attenuation, readings and noise, compared with published values and Poisson statistics."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.comparison.mammogram_image import Noise, expose, read_out
from palpate.workers.comparison.xray_beam import (
    BEAMS,
    Geometry,
    Spectrum,
    Unit,
    attenuation_per_mm,
    geometry_of,
    spectrum_of,
)


def far_geometry(rows: int = 40, columns: int = 50) -> Geometry:
    """Return a detector so distant and small that all pixels are equivalent."""
    return Geometry(
        np.array([0.0, 1000.0, 0.0]),
        np.zeros(3),
        np.array([1e-3, 0.0, 0.0]),
        np.array([0.0, 0.0, 1e-3]),
        rows,
        columns,
    )


def lengths(mm: dict[Tissue, float], geometry: Geometry) -> FloatArray:
    found = np.zeros((geometry.rows, geometry.columns, len(Tissue)))
    for tissue, length in mm.items():
        found[..., tissue] = length
    return found


# Johns and Yaffe, Phys. Med. Biol. 32 (1987) 675, measured; NIST XCOM for ICRU-44 muscle.
@pytest.mark.parametrize(
    ("tissue", "energy", "per_cm", "within"),
    [
        (Tissue.GLANDULAR, 20.0, 0.802, 0.01),
        (Tissue.GLANDULAR, 25.0, 0.506, 0.01),
        (Tissue.GLANDULAR, 30.0, 0.378, 0.01),
        (Tissue.MUSCLE, 20.0, 1.05 * 0.8205, 0.01),
        (Tissue.MUSCLE, 30.0, 1.05 * 0.3783, 0.01),
        # Their fat had less water than Hammerstein's adipose tissue.
        (Tissue.FAT, 20.0, 0.456, 0.14),
    ],
)
def test_attenuation_matches_the_literature(
    tissue: Tissue, energy: float, per_cm: float, within: float
) -> None:
    found = 10 * attenuation_per_mm(tissue, np.array([energy]))[0]
    assert found == pytest.approx(per_cm, rel=within)


def test_denser_tissue_and_lower_energy_attenuate_more() -> None:
    energies = np.linspace(8.1, 27.9, 50)
    fat, gland, skin = (
        attenuation_per_mm(t, energies) for t in (Tissue.FAT, Tissue.GLANDULAR, Tissue.SKIN)
    )
    assert (fat < gland).all()
    assert (gland < skin).all()
    assert (np.diff(gland) < 0).all()
    assert not attenuation_per_mm(Tissue.AIR, energies).any()


# Half-value layers computed by SpekPy for its own spectra; here from attenuation in aluminium: NIST
# XCOM, mass attenuation in cm2/g.
ALUMINIUM = np.array(
    [[8, 50.33], [10, 26.23], [15, 7.955], [20, 3.441], [30, 1.128]], dtype=np.float64
)
AIR_ENERGY_ABSORPTION = np.array(
    [[8, 9.446], [10, 4.742], [15, 1.334], [20, 0.5389], [30, 0.1537]], dtype=np.float64
)


@pytest.mark.parametrize(("beam", "hvl_mm"), [("mo_mo", 0.354), ("rh_rh", 0.401), ("w_rh", 0.510)])
def test_half_value_layer_halves_the_kerma(beam: str, hvl_mm: float) -> None:
    spectrum = spectrum_of(beam)  # type: ignore[arg-type]
    energies = spectrum.energies_kev

    def at(known: FloatArray) -> FloatArray:
        return np.asarray(np.exp(np.interp(np.log(energies), *np.log(known).T)))

    kerma = spectrum.photons_per_mm2_mas * energies * at(AIR_ENERGY_ABSORPTION)
    behind = kerma * np.exp(-at(ALUMINIUM) * 2.699 * hvl_mm / 10)
    assert behind.sum() / kerma.sum() == pytest.approx(0.5, abs=0.01)
    assert set(BEAMS) == {"mo_mo", "rh_rh", "w_rh"}


def test_monoenergetic_beam_follows_beers_law() -> None:
    geometry, beam = far_geometry(), Spectrum(np.array([20.0]), np.array([1e9]))
    found = read_out(lengths({Tissue.FAT: 30.0, Tissue.SKIN: 3.0}, geometry), geometry, beam, mas=2)
    mu = {t: attenuation_per_mm(t, np.array([20.0]))[0] for t in (Tissue.FAT, Tissue.SKIN)}
    wanted = 30 * mu[Tissue.FAT] + 3 * mu[Tissue.SKIN]
    np.testing.assert_allclose(found.log_attenuation, wanted, rtol=1e-9)
    # 20 keV photons at 1000 mm on 1e-6 mm2.
    np.testing.assert_allclose(found.open_kev, 20 * 2 * 1e9 * 1e-6, rtol=1e-6)


def test_polyenergetic_beam_hardens() -> None:
    """Unlike with a single energy, twice the tissue attenuates less than twice as much."""
    geometry, beam = far_geometry(), spectrum_of("w_rh")
    once, twice = (
        read_out(lengths({Tissue.FAT: mm}, geometry), geometry, beam, mas=60).log_attenuation[0, 0]
        for mm in (25.0, 50.0)
    )
    mu = attenuation_per_mm(Tissue.FAT, beam.energies_kev)
    weight = beam.photons_per_mm2_mas * beam.energies_kev
    assert once < 25 * np.average(mu, weights=weight)
    assert 1.8 * once < twice < 1.99 * once


def test_quantum_noise_has_poisson_variance() -> None:
    geometry = far_geometry(200, 200)
    beam = Spectrum(np.array([10.0, 20.0]), np.array([5e6, 2e7]))
    noise = Noise(seed=3, electronic_kev=0.0)
    found = read_out(lengths({}, geometry), geometry, beam, mas=4, noise=noise)
    counts = np.array([20.0, 80.0])  # per pixel of 1e-6 mm2
    pixels = found.energy_kev.size
    mean, variance = counts @ beam.energies_kev, counts @ beam.energies_kev**2
    assert found.energy_kev.mean() == pytest.approx(mean, abs=4 * np.sqrt(variance / pixels))
    assert found.energy_kev.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / pixels))
    # Photons are counted as whole numbers: every reading is a multiple of 10 keV.
    np.testing.assert_allclose(found.energy_kev % 10, 0)


def test_electronic_noise_adds_its_own_variance() -> None:
    geometry, beam = far_geometry(200, 200), Spectrum(np.array([20.0]), np.array([1e7]))
    quiet, loud = (
        read_out(lengths({}, geometry), geometry, beam, mas=10, noise=Noise(1, sd)).energy_kev
        for sd in (0.0, 300.0)
    )
    added = loud - quiet  # the same photons
    assert added.std() == pytest.approx(300.0, rel=0.02)
    assert added.mean() == pytest.approx(0.0, abs=6.0)


def test_seed_determines_the_noise() -> None:
    body = Volume(np.ones((4, 20, 6), np.uint8), (1.0, 1.0, 1.0))
    geometry = geometry_of(body, unit=Unit(pixel_mm=1.0))
    first, again, other = (expose(body, geometry, noise=Noise(s)).energy_kev for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    still = expose(body, geometry)
    assert np.array_equal(still.energy_kev, expose(body, geometry).energy_kev)
    np.testing.assert_allclose(first.mean(), still.energy_kev.mean(), rtol=1e-2)


def test_intensity_falls_with_distance_and_slant() -> None:
    body = Volume(np.zeros((10, 10, 400), np.uint8), (1.0, 1.0, 1.0))
    body.values[0, 0, [0, -1]] = 1
    geometry = geometry_of(body, unit=Unit(pixel_mm=4.0))
    found = expose(body, geometry).open_kev
    ray = geometry.pixels_mm - geometry.source_mm
    r = np.linalg.norm(ray, axis=-1)
    np.testing.assert_allclose(found * r**3, (found * r**3)[0, 0], rtol=1e-9)
    assert found.min() < 0.95 * found.max()


def test_refuses_invalid_input() -> None:
    geometry = far_geometry(2, 2)
    with pytest.raises(InputError, match="exposure must be positive"):
        read_out(lengths({}, geometry), geometry, spectrum_of("mo_mo"), mas=0.0)
    with pytest.raises(InputError, match="one of mo_mo"):
        spectrum_of("w_ag")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="5 to 40 keV"):
        attenuation_per_mm(Tissue.FAT, np.array([80.0]))
    with pytest.raises(InputError, match="must be >= 0, got seed"):
        Noise(seed=-1)
    with pytest.raises(InputError, match="one photon count for each energy"):
        Spectrum(np.array([20.0]), np.array([1.0, 2.0]))
    with pytest.raises(InputError, match="all counts are 0"):
        Spectrum(np.array([20.0]), np.array([0.0]))

"""Readings of an ideal detector behind known lengths of tissue, with or without noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.mammogram.attenuation import attenuation_table
from palpate.workers.comparison.mammogram.geometry import Geometry
from palpate.workers.comparison.mammogram.path_lengths import path_lengths_mm
from palpate.workers.comparison.mammogram.spectrum import TABLE_DISTANCE_MM, Spectrum, spectrum_of

# Events of the electronic Poisson process; its skewness is one tenth.
ELECTRONIC_EVENTS = 100.0


@dataclass(frozen=True)
class Noise:
    """Noise in the readings of pixels.

    Parameters
    ----------
    seed : int
        Seed of both random processes.
    electronic_kev : float
        Standard deviation of the electronic noise, in keV of absorbed energy. In amorphous
        selenium, some 2,000 electrons of 50 eV each amount to 100 keV.

    Raises
    ------
    InputError
        If the seed or the standard deviation is negative.
    """

    seed: int = 0
    electronic_kev: float = 100.0

    def __post_init__(self) -> None:
        if self.seed < 0 or not self.electronic_kev >= 0:
            raise InputError(
                f"The seed and the electronic noise must be >= 0, got seed {self.seed} and "
                f"{self.electronic_kev:g} keV."
            )


@dataclass(frozen=True, eq=False)
class Mammogram:
    """The readings of a detector.

    Parameters
    ----------
    energy_kev : ndarray of float64, shape (rows, columns)
        Energy absorbed in each pixel.
    open_kev : ndarray of float64, shape (rows, columns)
        Energy without a body and without noise.
    geometry : Geometry
    """

    energy_kev: FloatArray
    open_kev: FloatArray
    geometry: Geometry

    @property
    def log_attenuation(self) -> FloatArray:
        """ln(open / energy), where readings below 1 keV count as 1 keV."""
        return np.asarray(np.log(self.open_kev / np.maximum(self.energy_kev, 1.0)))


def expose(
    body: Volume,
    geometry: Geometry,
    spectrum: Spectrum | None = None,
    *,
    mas: float = 60.0,
    noise: Noise | None = None,
) -> Mammogram:
    """Take a mammogram.

    The focal spot is a point, the beam polyenergetic without scatter, and the detector
    ideal: it absorbs every photon that meets a pixel and reads the sum of their energies
    (thesis section 4.4.3).

    Parameters
    ----------
    body : Volume
        `Tissue` labels.
    geometry : Geometry
    spectrum : Spectrum, optional
        A tungsten anode with a rhodium filter by default.
    mas : float
        Tube current times exposure time, > 0.
    noise : Noise, optional
        Noise of the reading; by default, the expected reading is returned.

    Raises
    ------
    InputError
        If the exposure is not positive, or a value is not a label.
    """
    lengths = path_lengths_mm(body, geometry)
    return read_out(lengths, geometry, spectrum or spectrum_of("w_rh"), mas=mas, noise=noise)


def read_out(
    lengths_mm: NDArray[np.floating],
    geometry: Geometry,
    spectrum: Spectrum,
    *,
    mas: float,
    noise: Noise | None = None,
) -> Mammogram:
    r"""Return an expected or noisy reading behind known lengths of tissue.

    In a bin of energy E, a pixel receives an expected

    .. math:: N_E = \text{mAs} \, \phi_E \, A \cos\theta \, (1000 / r)^2
              \exp\Big(-\sum_t \mu_t(E) L_t\Big)

    photons and reads :math:`\sum_E E N_E`. With noise, N is drawn from a Poisson distribution in
    each bin, and the electronics add a second Poisson process minus its mean.

    Parameters
    ----------
    lengths_mm : ndarray, shape (rows, columns, tissues)
    geometry, spectrum, mas, noise
        See `expose`.

    Raises
    ------
    InputError
        If the exposure is not positive.
    """
    if not mas > 0:
        raise InputError(f"The exposure must be positive, got {mas:g} mAs.")
    energies = spectrum.energies_kev
    attenuation = attenuation_table(energies)
    photons = mas * spectrum.photons_per_mm2_mas[:, None] * _weight_mm2(geometry).ravel()
    open_kev = (energies @ photons).reshape(geometry.rows, geometry.columns)
    energy = np.empty_like(open_kev)
    generator = None if noise is None else np.random.default_rng(noise.seed)
    for row in range(geometry.rows):  # row by row, to limit the memory of the energy bins
        part = photons[:, row * geometry.columns : (row + 1) * geometry.columns]
        counts = part * np.exp(-(attenuation.T @ lengths_mm[row].T.astype(np.float64)))
        if generator is not None:
            counts = generator.poisson(counts).astype(np.float64)
        energy[row] = energies @ counts
    if noise is not None and generator is not None and noise.electronic_kev > 0:
        events = generator.poisson(ELECTRONIC_EVENTS, energy.shape) - ELECTRONIC_EVENTS
        energy += events * (noise.electronic_kev / np.sqrt(ELECTRONIC_EVENTS))
    return Mammogram(energy, open_kev, geometry)


def _weight_mm2(geometry: Geometry) -> FloatArray:
    """Return each pixel's area as seen from the focal spot, scaled to the table's distance."""
    ray = geometry.pixels_mm - geometry.source_mm
    distance = np.linalg.norm(ray, axis=-1)
    normal = np.cross(geometry.down_mm, geometry.right_mm)  # its length is the pixel's area
    seen = np.abs(ray @ normal) / distance
    return np.asarray(seen * (TABLE_DISTANCE_MM / distance) ** 2)

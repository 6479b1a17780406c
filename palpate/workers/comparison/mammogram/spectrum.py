"""X-ray spectra of mammography tubes."""

from dataclasses import dataclass
from typing import Literal, get_args

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.mammogram.tables import table

Beam = Literal["mo_mo", "rh_rh", "w_rh"]
BEAMS: tuple[Beam, ...] = get_args(Beam)
TABLE_DISTANCE_MM = 1000.0
# Bins with a smaller fraction of all photons are omitted.
NEGLIGIBLE = 1e-7


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Spectrum of the photons that reach the body.

    Parameters
    ----------
    energies_kev : ndarray, shape (k,)
        Photon energies, ascending.
    photons_per_mm2_mas : ndarray, shape (k,)
        Photons in each bin per mAs, 1000 mm from the focal spot.

    Raises
    ------
    InputError
        If the arrays differ in shape, or contain no photons.
    """

    energies_kev: FloatArray
    photons_per_mm2_mas: FloatArray

    def __post_init__(self) -> None:
        energies, photons = self.energies_kev, self.photons_per_mm2_mas
        if energies.shape != photons.shape or energies.ndim != 1:
            raise InputError(
                "A spectrum needs one photon count for each energy, got shapes "
                f"{energies.shape} and {photons.shape}."
            )
        if not photons.sum() > 0:
            raise InputError("A spectrum needs at least one photon, but all counts are 0.")


def spectrum_of(beam: Beam) -> Spectrum:
    """Return the spectrum of an anode and a filter at 28 kVp, behind a compression plate.

    Parameters
    ----------
    beam : {"mo_mo", "rh_rh", "w_rh"}
        Anode and filter: molybdenum, rhodium, or tungsten with rhodium.

    Raises
    ------
    InputError
        If the beam is unknown.
    """
    if beam not in BEAMS:
        raise InputError(f"The beam must be one of {', '.join(BEAMS)}, got {beam!r}.")
    energies, photons = table(f"{beam}_28kvp").T
    kept = photons > NEGLIGIBLE * photons.sum()
    return Spectrum(energies[kept], photons[kept])

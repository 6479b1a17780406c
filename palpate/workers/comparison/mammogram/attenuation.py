"""X-ray attenuation of each tissue."""

from typing import Final

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue
from palpate.workers.comparison.mammogram.tables import table

# Cooper's ligaments are fibrous like the stroma of the gland.
TABLES: Final = {
    Tissue.FAT: "adipose",
    Tissue.GLANDULAR: "glandular",
    Tissue.SKIN: "skin",
    Tissue.MUSCLE: "muscle",
    Tissue.LIGAMENT: "glandular",
}


def attenuation_per_mm(tissue: Tissue, energies_kev: FloatArray) -> FloatArray:
    """Return the linear attenuation coefficient, including scatter, in 1/mm.

    Parameters
    ----------
    tissue : Tissue
        Tissue; air does not attenuate.
    energies_kev : ndarray
        Energies from 5 to 40 keV; logarithms are interpolated between the rows of the table.

    Raises
    ------
    InputError
        If an energy is outside the table.

    Examples
    --------
    >>> mu = attenuation_per_mm(Tissue.GLANDULAR, np.array([20.0]))
    >>> round(float(mu[0]), 3)
    0.08
    """
    energies = np.asarray(energies_kev, np.float64)
    if tissue == Tissue.AIR:
        return np.zeros_like(energies)
    known, values = table(TABLES[tissue]).T
    if energies.size and not (known[0] <= energies.min() and energies.max() <= known[-1]):
        raise InputError(
            f"Attenuation is known from {known[0]:g} to {known[-1]:g} keV, but {energies.min():g} "
            f"to {energies.max():g} keV was requested. Use a mammography spectrum."
        )
    return np.asarray(np.exp(np.interp(np.log(energies), np.log(known), np.log(values))))


def attenuation_table(energies_kev: FloatArray) -> FloatArray:
    """Return coefficients of all tissues, in the order of `Tissue`, (tissues, energies), 1/mm."""
    return np.stack([attenuation_per_mm(tissue, energies_kev) for tissue in Tissue])

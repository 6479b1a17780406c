"""Grey values of mammograms for screens and files."""

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.mammogram.exposure import Mammogram

# Percentiles of the pixels behind the body; darker and brighter values saturate.
PERCENTILES = (1.0, 99.5)
# Pixels with less attenuation than this, ln(open / energy), count as air.
AIR = 0.05
EQUAL = 128
# Fraction of the range of attenuations behind the body at which a difference saturates.
LARGEST_DIFFERENCE = 0.1


def presentation_values(mammogram: Mammogram, largest: int) -> NDArray[np.uint16]:
    """Return the log attenuation as whole numbers: dense tissue bright, air dark.

    Parameters
    ----------
    mammogram : Mammogram
    largest : int
        Value of the brightest pixel, up to 65535.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    attenuation = mammogram.log_attenuation
    low, high = window_of(attenuation)
    grey = np.clip((attenuation - low) / (high - low), 0.0, 1.0)
    return np.asarray(np.rint(grey * largest), np.uint16)


def processing_values(mammogram: Mammogram, largest: int) -> NDArray[np.uint16]:
    """Return the energy as whole numbers on a linear scale, with the open field at nine tenths.

    Parameters
    ----------
    mammogram : Mammogram
    largest : int
        Largest value, up to 65535.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    scale = 0.9 * largest / float(mammogram.open_kev.max())
    return np.asarray(np.rint(np.clip(mammogram.energy_kev * scale, 0, largest)), np.uint16)


def grey_picture(mammogram: Mammogram) -> NDArray[np.uint8]:
    """Return the 8-bit picture for presentation."""
    return presentation_values(mammogram, 255).astype(np.uint8)


def difference_picture(first: Mammogram, second: Mammogram) -> NDArray[np.uint8]:
    """Return the signed difference of attenuations (thesis Fig. 4.18): grey if equal.

    White (black) means that the first (second) attenuates more, by a tenth of the range of the
    first; differences between breasts are hundredths of that range.

    Raises
    ------
    InputError
        If the mammograms have different numbers of pixels.
    """
    a, b = first.log_attenuation, second.log_attenuation
    if a.shape != b.shape:
        raise InputError(
            f"The mammograms have different shapes, {a.shape} and {b.shape} pixels. Take both in "
            "the same geometry."
        )
    low, high = window_of(a)
    grey = EQUAL + 127 * (a - b) / (LARGEST_DIFFERENCE * (high - low))
    return np.asarray(np.rint(np.clip(grey, 0, 255)), np.uint8)


def window_of(attenuation: FloatArray) -> tuple[float, float]:
    """Return the darkest and brightest attenuation of a picture."""
    body = attenuation[attenuation > AIR]
    if not body.size:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(body, PERCENTILES))
    return low, max(high, low + 1e-6)

"""Mammograms of one phantom compressed on two meshes (thesis section 4.4, Fig. 4.18)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.comparison.mammogram.exposure import Mammogram, Noise, expose
from palpate.workers.comparison.mammogram.geometry import Unit, geometry_of
from palpate.workers.comparison.mammogram.picture import difference_picture, grey_picture
from palpate.workers.comparison.mammogram.spectrum import Beam, spectrum_of
from palpate.workers.thesis.compression import AXES, Compressed, View
from palpate.workers.thesis.scale import Scale

PIXEL_MM: dict[Scale, float] = {"sketch": 0.8, "reduced": 0.3, "full": 0.2}


@dataclass(frozen=True, eq=False)
class MammogramPair:
    """Mammograms of a phantom on its adaptive and homogeneous meshes, from the same unit.

    Parameters
    ----------
    adaptive, homogeneous : Mammogram
        Mammograms with different noise of equal strength.
    adaptive_picture, homogeneous_picture, difference : ndarray of uint8
        Mammograms, bright where tissue is dense, and their difference, grey where both agree.
    attenuation_rms : float
        Root mean square of the difference in ln(open / energy) behind the body.
    quantum_rms : float
        Contribution of noise alone to `attenuation_rms`.
    """

    adaptive: Mammogram
    homogeneous: Mammogram
    adaptive_picture: NDArray[np.uint8]
    homogeneous_picture: NDArray[np.uint8]
    difference: NDArray[np.uint8]
    attenuation_rms: float
    quantum_rms: float


def mammogram_pair(
    adaptive: Compressed,
    homogeneous: Compressed,
    view: View,
    pixel_mm: float,
    *,
    beam: Beam = "w_rh",
    seed: int = 0,
) -> MammogramPair:
    """Take mammograms of two compressions in the geometry of the first.

    Raises
    ------
    InputError
        If one of the compressions did not converge.
    """
    first, second = adaptive.labels, homogeneous.labels
    if first is None or second is None:
        reasons = [c.outcome.reason for c in (adaptive, homogeneous) if c.labels is None]
        raise InputError(f"A mammogram needs a converged compression: {'; '.join(reasons)}.")
    geometry = geometry_of(first, AXES[view], Unit(pixel_mm=pixel_mm))
    spectrum = spectrum_of(beam)
    clean = [expose(body, geometry, spectrum) for body in (first, second)]
    noisy = [
        expose(body, geometry, spectrum, noise=Noise(seed + k))
        for k, body in enumerate((first, second))
    ]
    behind = clean[0].log_attenuation > 0.05

    def rms(a: Mammogram, b: Mammogram) -> float:
        apart = (a.log_attenuation - b.log_attenuation)[behind]
        return float(np.sqrt(np.mean(apart**2)))

    return MammogramPair(
        adaptive=noisy[0],
        homogeneous=noisy[1],
        adaptive_picture=grey_picture(noisy[0]),
        homogeneous_picture=grey_picture(noisy[1]),
        difference=difference_picture(noisy[0], noisy[1]),
        attenuation_rms=rms(noisy[0], noisy[1]),
        quantum_rms=float(np.hypot(rms(noisy[0], clean[0]), rms(noisy[1], clean[1]))),
    )

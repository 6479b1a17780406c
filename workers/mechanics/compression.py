"""States how two plates press a body, for whoever draws or describes it."""

from dataclasses import dataclass

import numpy as np

from storage.values import Triple


@dataclass(frozen=True)
class Compression:
    """Two rigid plates and what moves them.

    Parameters
    ----------
    axis : tuple of float
        From the lower to the upper plate, of length 1.
    force_n : float or None
        None where the plates stand at a distance.
    """

    axis: Triple = (0.0, 1.0, 0.0)
    force_n: float | None = None


def compression_axis(oblique_deg: float) -> Triple:
    """Return the direction from the lower to the upper plate, turned about z from y to -x."""
    angle = np.radians(oblique_deg)
    return -float(np.sin(angle)), float(np.cos(angle)), 0.0

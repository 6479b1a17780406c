"""Description of compression between plates, for drawings."""

from dataclasses import dataclass

from palpate.storage.values import Triple

ALONG_Y: Triple = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pressed:
    """Compression of a body between plates.

    Parameters
    ----------
    axis : tuple of float
        Direction from the lower to the upper plate.
    force_n : float or None
        Plate force; None for plates at a given distance.
    """

    axis: Triple = ALONG_Y
    force_n: float | None = None

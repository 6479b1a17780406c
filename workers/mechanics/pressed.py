"""Says how plates press a body, to whoever draws it."""

from dataclasses import dataclass

from palpate.storage.values import Triple

ALONG_Y: Triple = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pressed:
    """How plates press a body.

    Parameters
    ----------
    axis : tuple of float
        From the lower to the upper plate.
    force_n : float or None
        None where the plates stand at a distance.
    """

    axis: Triple = ALONG_Y
    force_n: float | None = None

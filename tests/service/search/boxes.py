"""What the tests of a search ask of a box."""

import numpy as np
from numpy.typing import NDArray

from palpate.service.search.space import Space


def contains(space: Space, genes: NDArray[np.float64]) -> bool:
    """Return whether every gene (n, d) lies within its bounds, the walls included."""
    return bool(np.all((genes >= np.asarray(space.lower)) & (genes <= np.asarray(space.upper))))

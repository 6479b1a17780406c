"""Helpers for tests of searches in a box."""

import numpy as np
from numpy.typing import NDArray

from palpate.service.search.search_interface import Space


def contains(space: Space, genes: NDArray[np.float64]) -> bool:
    """Return True if every gene (n, d) is within its bounds, inclusive."""
    return bool(np.all((genes >= np.asarray(space.lower)) & (genes <= np.asarray(space.upper))))

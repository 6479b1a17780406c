"""Space-filling designs within the bounds of a search, from `scipy.stats.qmc`."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import qmc

from palpate.service.search.search_interface import FloatArray, Space
from palpate.storage.errors import InputError

DESIGNS: dict[str, Callable[..., Any]] = {
    "sobol": qmc.Sobol,
    "halton": qmc.Halton,
    "latin-hypercube": qmc.LatinHypercube,
}


def design(space: Space, kind: str = "sobol", n: int = 64, seed: int = 1) -> FloatArray:
    """Return points that fill a box evenly.

    Parameters
    ----------
    space : Space
        A box with d parameters.
    kind : {"sobol", "halton", "latin-hypercube"}
        All are scrambled; a Sobol design is balanced where `n` is a power of two.
    n : int
        Number of points, >= 1.
    seed : int
        The same seed gives the same points.

    Returns
    -------
    ndarray, shape (n, d)
        In the units of the space.

    Raises
    ------
    InputError
        If the design is unknown, or `n` or `seed` is too small.

    Examples
    --------
    >>> space = Space.from_bounds({"E_fat_kpa": (5, 20), "nu": (0.45, 0.49)})
    >>> points = design(space, "sobol", 8)
    >>> points.shape, bool((points >= space.lower).all() and (points <= space.upper).all())
    ((8, 2), True)
    """
    if kind not in DESIGNS:
        raise InputError(f"There is no design {kind!r}: use one of {', '.join(DESIGNS)}.")
    if n < 1:
        raise InputError(f"A design needs at least one point, found {n}.")
    if seed < 0:
        raise InputError(f"The seed of a design must not be negative, found {seed}.")
    sampler = DESIGNS[kind](space.dimension, rng=np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # raised if n is not a power of two
        return space.from_unit(sampler.random(n))


def design_columns(
    space: Space, kind: str = "sobol", n: int = 64, seed: int = 1
) -> dict[str, FloatArray]:
    """Return the points of a `design`, shape (n,), by parameter name."""
    return dict(zip(space.names, design(space, kind, n, seed).T, strict=True))

"""Offer laws with their constants still open, in the form in which they are fitted.

The stress of a law is linear in some constants, its moduli, and not in the others,
its exponents. With exponents given, the best moduli follow from linear least squares,
so only exponents need a search, and only they need a place to start from.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.base import Isochoric
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.mooney_rivlin import MooneyRivlin
from palpate.workers.mechanics.materials.neo_hookean import NeoHookean
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.yeoh import Yeoh

ALPHAS = (-25.0, -16.0, -8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 25.0)
MOST_TERMS = 4
RATES = tuple((float(b),) for b in np.geomspace(1e-3, 100, 11))


@dataclass(frozen=True, eq=False)
class Family:
    """Describe one form of law.

    Parameters
    ----------
    name : str
    build : callable
        Makes the law of moduli in MPa and exponents. The first modulus is above zero
        for every law, and a law may be built of the first alone.
    moduli_least : tuple of float
        Lower bound of each modulus, 0 or minus infinity.
    starts : tuple of tuple of float
        Exponents to start a search from; one empty tuple if there are none.
    exponent_range : tuple of float, or of sequences of float
        Bounds of every exponent, or of each.
    """

    name: str
    build: Callable[[FloatArray, FloatArray], Isochoric]
    moduli_least: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...] = ((),)
    exponent_range: tuple[float | Sequence[float], float | Sequence[float]] = (-100.0, 100.0)

    @property
    def constants(self) -> int:
        """Return how many numbers a fit has to find."""
        return len(self.moduli_least) + len(self.starts[0])


def _mooney_rivlin(moduli: FloatArray, _: FloatArray) -> Isochoric:
    half, *others = (float(m) for m in moduli)
    return MooneyRivlin(half - others[0], *others)


ANY = -np.inf
NEO_HOOKEAN = Family("neo-Hookean", lambda m, _: NeoHookean(float(m[0])), (0.0,))
MOONEY_RIVLIN = Family("Mooney-Rivlin, 2 constants", _mooney_rivlin, (0.0, ANY))
MOONEY_RIVLIN_5 = Family("Mooney-Rivlin, 5 constants", _mooney_rivlin, (0.0, *[ANY] * 4))
YEOH = Family("Yeoh", lambda m, _: Yeoh(*(float(c) for c in m)), (0.0, ANY, ANY))
FUNG = Family("Fung", lambda m, b: Fung(float(m[0]), float(b[0])), (0.0,), RATES, (1e-6, 1e3))


def ogden(terms: int) -> Family:
    """Return Ogden's law, each term of which adds stiffness.

    A term with ``mu alpha >= 0`` keeps the law stable in every deformation; fitted
    without that bound, terms of opposite sign follow the table and misbehave next to it.

    Parameters
    ----------
    terms : int
        1 to 4; a table of a few dozen points decides no more.

    Raises
    ------
    InputError
        If there are fewer or more.
    """
    if not 1 <= terms <= MOST_TERMS:
        raise InputError(f"An Ogden law is fitted with 1 to {MOST_TERMS} terms, got {terms}.")
    return Family(
        f"Ogden, {terms} terms" if terms > 1 else "Ogden, 1 term",
        lambda m, alpha: Ogden.from_convention("abaqus", _floats(m), _floats(alpha)),
        (0.0,) * terms,
        tuple(combinations(ALPHAS, terms)),
    )


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)

"""Families of laws with free constants, in the form used for fitting.

The stress of a law is linear in some constants, its moduli, and nonlinear in the others,
its exponents. For given exponents the best moduli follow from linear least squares,
so only exponents need a search and starting values.
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
    """Family of laws of one form.

    Parameters
    ----------
    name : str
    build : callable
        Makes a law from moduli in MPa and exponents. The first modulus is above zero for
        every law, and is sufficient to build one.
    moduli_least : tuple of float
        Lower bound of each modulus, 0 or minus infinity.
    starts : tuple of tuple of float
        Starting values of the exponents; one empty tuple if there are none.
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
        """Return the number of constants to fit."""
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
    """Return the family of Ogden laws whose terms all add stiffness.

    Terms with ``mu alpha >= 0`` keep the law stable in every deformation; without that
    bound, fitted terms of opposite sign match the table but misbehave outside it.

    Parameters
    ----------
    terms : int
        1 to 4; a table of a few dozen points cannot determine more.

    Raises
    ------
    InputError
        If there are fewer or more.
    """
    if not 1 <= terms <= MOST_TERMS:
        raise InputError(f"An Ogden law must have 1 to {MOST_TERMS} terms, got {terms}.")
    return Family(
        f"Ogden, {terms} terms" if terms > 1 else "Ogden, 1 term",
        lambda m, alpha: Ogden.from_convention("abaqus", _floats(m), _floats(alpha)),
        (0.0,) * terms,
        tuple(combinations(ALPHAS, terms)),
    )


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)

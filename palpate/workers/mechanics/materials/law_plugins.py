"""Material laws as plug-ins, which files choose by name, and their form used for fitting.

A law is given by its shear modulus at rest, mu0, and its shape constants, which describe its
deviation from a neo-Hookean law under strain. A distribution provides a `LawPlugin` as an entry
point of the group ``palpate.laws``.

In a file a shape constant is prefixed by the name of the law, ``yeoh_c2``, and in a breast
followed by the tissue, ``yeoh_c2_fat``.

A `LawFamily` has the free constants of a law, in the form used for fitting. The stress of a law is
linear in some constants, its moduli, and nonlinear in the others, its exponents. For given
exponents the best moduli follow from linear least squares, so only exponents need a search and
starting values.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import Isochoric
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin, NeoHookean, Yeoh
from palpate.workers.mechanics.model_parameters import NUMBER, Parameter
from palpate.workers.plugins import load, plugins

OGDEN_EXPONENTS = (-25.0, -16.0, -8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 25.0)
MOST_OGDEN_TERMS = 4
FUNG_RATES = tuple((float(b),) for b in np.geomspace(1e-3, 100, 11))


@dataclass(frozen=True, eq=False)
class LawFamily:
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


def _mooney_rivlin_of_moduli(moduli: FloatArray, _: FloatArray) -> Isochoric:
    half, *others = (float(m) for m in moduli)
    return MooneyRivlin(half - others[0], *others)


NO_BOUND = -np.inf
NEO_HOOKEAN_FAMILY = LawFamily("neo-Hookean", lambda m, _: NeoHookean(float(m[0])), (0.0,))
MOONEY_RIVLIN_FAMILY = LawFamily(
    "Mooney-Rivlin, 2 constants", _mooney_rivlin_of_moduli, (0.0, NO_BOUND)
)
MOONEY_RIVLIN_5_FAMILY = LawFamily(
    "Mooney-Rivlin, 5 constants", _mooney_rivlin_of_moduli, (0.0, *[NO_BOUND] * 4)
)
YEOH_FAMILY = LawFamily(
    "Yeoh", lambda m, _: Yeoh(*(float(c) for c in m)), (0.0, NO_BOUND, NO_BOUND)
)
FUNG_FAMILY = LawFamily(
    "Fung", lambda m, b: Fung(float(m[0]), float(b[0])), (0.0,), FUNG_RATES, (1e-6, 1e3)
)


def ogden_family(terms: int) -> LawFamily:
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
    if not 1 <= terms <= MOST_OGDEN_TERMS:
        raise InputError(f"An Ogden law must have 1 to {MOST_OGDEN_TERMS} terms, got {terms}.")
    return LawFamily(
        f"Ogden, {terms} terms" if terms > 1 else "Ogden, 1 term",
        lambda m, alpha: Ogden.from_convention("abaqus", _floats(m), _floats(alpha)),
        (0.0,) * terms,
        tuple(combinations(OGDEN_EXPONENTS, terms)),
    )


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


DEFAULT_LAW = "neo-hookean"
ANY_NUMBER = (-math.inf, math.inf)
# The energy of an Ogden term is 0/0 at the exponent 0; within this distance it is constant.
LEAST_EXPONENT = 1e-3

Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class LawPlugin:
    """Named law.

    Parameters
    ----------
    name : str
        Name in a file, such as ``yeoh``.
    label : str
        Name for display, such as ``Yeoh``.
    parameters : tuple of Parameter
        Shape constants. At their neutral values the law is the plug-in's basic one; Palpate's
        built-in laws are then neo-Hookean.
    make : callable
        Maps the shear modulus at rest in MPa and all shape constants by name, in internal units, to
        the law. Energies are proportional to the modulus. It is also called slightly outside the
        admissible values, for finite differences.
    family : Family, optional
        Form used for fitting to tables; without it the shape constants are searched between
        their bounds.
    shape : callable, optional
        With `family`: maps a fitted law to its shape constants.
    """

    name: str
    label: str
    parameters: tuple[Parameter, ...]
    make: Callable[[float, Values], Isochoric]
    family: LawFamily | None = None
    shape: Callable[[Any], Values] = lambda law: {}

    def constants(self, tissue: str = "") -> tuple[Parameter, ...]:
        """Return the shape constants named as in a file, of one tissue if the body has several."""
        prefix, suffix = _prefix(self.name), f"_{tissue}" if tissue else ""
        of = f" of {tissue}" if tissue else ""
        return tuple(
            replace(
                p,
                name=f"{prefix}{p.name}{suffix}",
                description=f"{self.label}{of}: {p.description}",
            )
            for p in self.parameters
        )

    def law(self, shear_modulus_mpa: float, values: Values, tissue: str = "") -> Isochoric:
        """Return the law with these constants.

        Parameters
        ----------
        shear_modulus_mpa : float
            Shear modulus at rest, > 0.
        values : mapping of str to float
            Shape constants in internal units, by the names of `constants`; others are neutral.
        tissue : str
            As in `constants`.
        """
        named = zip(self.parameters, self.constants(tissue), strict=True)
        shape = {p.name: values.get(long.name, p.neutral) for p, long in named}
        return self.make(shear_modulus_mpa, shape)  # type: ignore[arg-type]


def law_named(name: str) -> LawPlugin:
    """Return the law with this name.

    Raises
    ------
    InputError
        If there is none; close names are suggested.
    """
    found: LawPlugin = load("laws", name)
    return found


def law_names() -> tuple[str, ...]:
    """Return the names of all laws, Palpate's own first."""
    return tuple(plugins("laws"))


def law_of_constant(name: str) -> str:
    """Return the law that the name of a shape constant begins with, or "".

    Examples
    --------
    >>> law_of_constant("fung_b_fat")
    'fung'
    >>> law_of_constant("E_fat_kpa")
    ''
    """
    return max((law for law in law_names() if name.startswith(_prefix(law))), key=len, default="")


def _prefix(law: str) -> str:
    return law.replace("-", "_") + "_"


def _number_parameter(
    name: str, bounds: tuple[float, float], neutral: float, description: str
) -> Parameter:
    return Parameter(name, NUMBER, *bounds, neutral, description, admissible=ANY_NUMBER)


def _exponent(alpha: float) -> float:
    return alpha if abs(alpha) >= LEAST_EXPONENT else math.copysign(LEAST_EXPONENT, alpha)


def _mooney_rivlin(mu: float, shape: Values) -> Isochoric:
    return MooneyRivlin(mu / 2 * (1 - shape["share2"]), mu / 2 * shape["share2"])


def _yeoh(mu: float, shape: Values) -> Isochoric:
    return Yeoh(mu / 2, mu * shape["c2"], mu * shape["c3"])


def _fung(mu: float, shape: Values) -> Isochoric:
    return Fung(mu, shape["b"]) if shape["b"] > 0 else NeoHookean(mu)


def _ogden(mu: float, shape: Values) -> Isochoric:
    return Ogden.from_convention("abaqus", (mu,), (_exponent(shape["alpha"]),))


def _ogden_2(mu: float, shape: Values) -> Isochoric:
    second = mu * shape["share2"]
    exponents = _exponent(shape["alpha1"]), _exponent(shape["alpha2"])
    return Ogden.from_convention("abaqus", (mu - second, second), exponents)


def _shape_of_two_terms(law: Ogden) -> Values:
    second = law.mu_mpa[1] * law.alpha[1] / 2
    alpha1, alpha2 = law.alpha
    return {"alpha1": alpha1, "alpha2": alpha2, "share2": second / law.shear_modulus_mpa}


SHARE = "part of the shear modulus at rest due to the second term"

NEO_HOOKEAN = LawPlugin(
    DEFAULT_LAW, "neo-Hookean", (), lambda mu, _: NeoHookean(mu), NEO_HOOKEAN_FAMILY
)
MOONEY_RIVLIN = LawPlugin(
    "mooney-rivlin",
    "Mooney-Rivlin",
    (_number_parameter("share2", (0.0, 1.0), 0.0, SHARE),),
    _mooney_rivlin,
    MOONEY_RIVLIN_FAMILY,
    lambda law: {"share2": 2 * law.c01_mpa / law.shear_modulus_mpa},
)
YEOH = LawPlugin(
    "yeoh",
    "Yeoh",
    (
        _number_parameter("c2", (0.0, 5.0), 0.0, "c2/mu0, coefficient of the square of I1bar - 3"),
        _number_parameter("c3", (0.0, 10.0), 0.0, "c3/mu0, coefficient of the cube of I1bar - 3"),
    ),
    _yeoh,
    YEOH_FAMILY,
    lambda law: {
        "c2": law.c2_mpa / law.shear_modulus_mpa,
        "c3": law.c3_mpa / law.shear_modulus_mpa,
    },
)
FUNG = LawPlugin(
    "fung",
    "Fung",
    (
        Parameter(
            "b", NUMBER, 0.0, 20.0, 0.0, "rate of the exponential in I1bar - 3", open_lower=False
        ),
    ),
    _fung,
    FUNG_FAMILY,
    lambda law: {"b": law.b},
)
OGDEN = LawPlugin(
    "ogden",
    "Ogden",
    (_number_parameter("alpha", (2.0, 30.0), 2.0, "exponent of the stretches; 2 is neo-Hookean"),),
    _ogden,
    ogden_family(1),
    lambda law: {"alpha": law.alpha[0]},
)
OGDEN_2 = LawPlugin(
    "ogden-2",
    "Ogden with two terms",
    (
        _number_parameter("alpha1", (2.0, 30.0), 2.0, "exponent of the first term"),
        _number_parameter("alpha2", (-30.0, -2.0), -2.0, "exponent of the second term"),
        _number_parameter("share2", (0.0, 1.0), 0.0, SHARE),
    ),
    _ogden_2,
    ogden_family(2),
    _shape_of_two_terms,
)

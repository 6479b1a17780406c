"""Material laws as plug-ins, which files choose by name.

A law is given by its shear modulus at rest, mu0, and its shape constants, which describe its
deviation from a neo-Hookean law under strain. A distribution provides a `LawPlugin` as an entry
point of the group ``palpate.laws``.

In a file a shape constant is prefixed by the name of the law, ``yeoh_c2``, and in a breast
followed by the tissue, ``yeoh_c2_fat``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from palpate.workers.mechanics.materials import law_families
from palpate.workers.mechanics.materials.base import Isochoric
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.law_families import Family
from palpate.workers.mechanics.materials.mooney_rivlin import MooneyRivlin
from palpate.workers.mechanics.materials.neo_hookean import NeoHookean
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.yeoh import Yeoh
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.plugins import load, plugins
from palpate.workers.units import NUMBER

DEFAULT_LAW = "neo-hookean"
ANY = (-math.inf, math.inf)
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
    family: Family | None = None
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


def _number(name: str, bounds: tuple[float, float], neutral: float, description: str) -> Parameter:
    return Parameter(name, NUMBER, *bounds, neutral, description, admissible=ANY)


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
    DEFAULT_LAW, "neo-Hookean", (), lambda mu, _: NeoHookean(mu), law_families.NEO_HOOKEAN
)
MOONEY_RIVLIN = LawPlugin(
    "mooney-rivlin",
    "Mooney-Rivlin",
    (_number("share2", (0.0, 1.0), 0.0, SHARE),),
    _mooney_rivlin,
    law_families.MOONEY_RIVLIN,
    lambda law: {"share2": 2 * law.c01_mpa / law.shear_modulus_mpa},
)
YEOH = LawPlugin(
    "yeoh",
    "Yeoh",
    (
        _number("c2", (0.0, 5.0), 0.0, "c2/mu0, coefficient of the square of I1bar - 3"),
        _number("c3", (0.0, 10.0), 0.0, "c3/mu0, coefficient of the cube of I1bar - 3"),
    ),
    _yeoh,
    law_families.YEOH,
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
            "b",
            NUMBER,
            0.0,
            20.0,
            0.0,
            "rate of the exponential in I1bar - 3",
            open_lower=False,
        ),
    ),
    _fung,
    law_families.FUNG,
    lambda law: {"b": law.b},
)
OGDEN = LawPlugin(
    "ogden",
    "Ogden",
    (_number("alpha", (2.0, 30.0), 2.0, "exponent of the stretches; 2 is neo-Hookean"),),
    _ogden,
    law_families.ogden(1),
    lambda law: {"alpha": law.alpha[0]},
)
OGDEN_2 = LawPlugin(
    "ogden-2",
    "Ogden with two terms",
    (
        _number("alpha1", (2.0, 30.0), 2.0, "exponent of the first term"),
        _number("alpha2", (-30.0, -2.0), -2.0, "exponent of the second term"),
        _number("share2", (0.0, 1.0), 0.0, SHARE),
    ),
    _ogden_2,
    law_families.ogden(2),
    _shape_of_two_terms,
)

"""Parameters of the model, shared by studies, searches and reports.

The forward model is one parametric family. A study frees some parameters and
holds the others at given or neutral values. An effect adds its own parameters,
whose neutral values change nothing, by `Vocabulary.extended_by`.

In files and other interfaces the unit is part of a parameter's name (its interface name),
``E_fat_kpa: 10``; the internal name and value are ``E_fat`` = 0.01 MPa.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeVar

from palpate.storage.errors import InputError
from palpate.workers.mechanics.readings import AS_IS, Reading
from palpate.workers.units import KPA, NUMBER, Unit

Bounds = tuple[float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Parameter:
    """Quantity of the model that can be known, searched or suspected.

    Values are in internal units (mm, N, MPa).

    Parameters
    ----------
    name : str
        Internal name, without unit.
    unit : Unit
        Unit in files.
    lower, upper : float
    Default search interval.
    neutral : float or None
        Value that applies if none is given. None: see `follows`.
    description : str
    admissible : tuple of float
        Lower and upper bound of meaningful values; the upper one is excluded.
    open_lower : bool
        Whether the lower bound of `admissible` is excluded as well.
    follows : str
        Name of the parameter whose value applies if this one is not given.
    reading : Reading
        Form in which its value is displayed.

    Raises
    ------
    InputError
        If the bounds are reversed, or a bound or the neutral value is not admissible.
    """

    name: str
    unit: Unit
    lower: float
    upper: float
    neutral: float | None
    description: str
    admissible: Bounds = (0.0, math.inf)
    open_lower: bool = True
    follows: str = ""
    reading: Reading = AS_IS

    def __post_init__(self) -> None:
        self.check_bounds((self.lower, self.upper))
        if self.neutral is not None:
            self.check(self.neutral)
        elif not self.follows:
            raise InputError(f"{self.name} needs a neutral value or a parameter that it follows.")

    @property
    def door_name(self) -> str:
        """Return the name with its unit, as used in study files."""
        return self.unit.name_at_door(self.name)

    @property
    def bounds(self) -> Bounds:
        """Return the default search interval."""
        return self.lower, self.upper

    def check(self, value: float) -> float:
        """Return `value` as a float if it is admissible.

        Raises
        ------
        InputError
            If it is not.
        """
        low, high = self.admissible
        above = value > low if self.open_lower else value >= low
        if not (math.isfinite(value) and above and value < high):
            raise InputError(
                f"{self.door_name} must be {self._range_text()}, "
                f"found {self.unit.to_door(value):g}."
            )
        return float(value)

    def check_bounds(self, bounds: Bounds) -> Bounds:
        """Return `bounds` if they are an interval of admissible values.

        Raises
        ------
        InputError
            If they are reversed, equal or not admissible.
        """
        lower, upper = (self.check(value) for value in bounds)
        if not lower < upper:
            low, high = (f"{self.unit.to_door(value):g}" for value in (lower, upper))
            fixed = "To hold it at one value, put it under case.constants."
            raise InputError(
                f"{self.door_name} needs [lower, upper] with lower < upper, found [{low}, {high}]. "
                + (f"Write [{high}, {low}]." if lower > upper else fixed)
            )
        return lower, upper

    def _range_text(self) -> str:
        low, high = (self.unit.to_door(value) for value in self.admissible)
        unit = f" {self.unit.symbol}".rstrip()
        parts = []
        if math.isfinite(low):
            parts.append(f"{'above' if self.open_lower else 'at least'} {low:g}{unit}")
        if math.isfinite(high):
            parts.append(f"below {high:g}{unit}")
        return " and ".join(parts) or "a finite number"


class Vocabulary:
    """Ordered parameters of a model.

    Parameters
    ----------
    parameters : iterable of Parameter
        Names must differ; `Parameter.follows` must name an earlier one.

    Raises
    ------
    InputError
        If a name occurs twice, or a parameter follows an unknown one.
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self._by_name: dict[str, Parameter] = {}
        for parameter in parameters:
            if parameter.name in self._by_name:
                raise InputError(f"The parameter {parameter.name} is defined twice.")
            if parameter.follows and parameter.follows not in self._by_name:
                raise InputError(
                    f"{parameter.name} follows {parameter.follows}, which is not defined before it."
                )
            self._by_name[parameter.name] = parameter

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Parameter:
        """Return the parameter with this internal name.

        Raises
        ------
        InputError
            If there is none; close names are suggested.
        """
        try:
            return self._by_name[name]
        except KeyError:
            raise InputError(unknown_name("parameter", name, self._by_name)) from None

    @property
    def names(self) -> tuple[str, ...]:
        """Return the internal names, in order."""
        return tuple(self._by_name)

    @property
    def door_names(self) -> tuple[str, ...]:
        """Return the interface names, which include units, in order."""
        return tuple(parameter.door_name for parameter in self)

    def at_door(self, door_name: str) -> Parameter:
        """Return the parameter with this name in a study file.

        Raises
        ------
        InputError
            If there is none; close names are suggested.
        """
        for parameter in self:
            if parameter.door_name == door_name:
                return parameter
        raise InputError(unknown_name("parameter", door_name, self.door_names))

    def extended_by(self, parameters: Iterable[Parameter]) -> "Vocabulary":
        """Return this vocabulary with further parameters appended."""
        return Vocabulary([*self, *parameters])

    def without(self, names: Iterable[str]) -> "Vocabulary":
        """Return this vocabulary without `names`."""
        left_out = set(names)
        return Vocabulary([p for p in self if p.name not in left_out])

    def from_door(self, values: Mapping[str, float]) -> dict[str, float]:
        """Convert interface names and units to internal ones, in the vocabulary's order.

        Raises
        ------
        InputError
            If a name is unknown or a value not admissible.
        """
        return self._translate(values, lambda p, value: p.check(p.unit.to_inside(value)))

    def bounds_from_door(self, values: Mapping[str, Bounds]) -> dict[str, Bounds]:
        """Convert search intervals from interface to internal names and units.

        Raises
        ------
        InputError
            If a name is unknown, an interval reversed or a value not admissible.
        """
        return self._translate(
            values,
            lambda p, b: p.check_bounds((p.unit.to_inside(b[0]), p.unit.to_inside(b[1]))),
        )

    def to_door(self, values: Mapping[str, float]) -> dict[str, float]:
        """Convert internal names and units to interface names and units."""
        return {self[name].door_name: self[name].unit.to_door(v) for name, v in values.items()}

    def complete(self, *stated: Mapping[str, float]) -> dict[str, float]:
        """Return values of all parameters: the last one given, or else the neutral one.

        Raises
        ------
        InputError
            If a given name is unknown or a value not admissible.
        """
        given = {name: self[name].check(v) for mapping in stated for name, v in mapping.items()}
        values: dict[str, float] = {}
        for p in self:
            if p.name in given:
                values[p.name] = given[p.name]
            else:
                values[p.name] = values[p.follows] if p.neutral is None else p.neutral
        return values

    def _translate(
        self, values: Mapping[str, T], convert: Callable[[Parameter, T], T]
    ) -> dict[str, T]:
        by_parameter = [(self.at_door(name), value) for name, value in values.items()]
        converted = {p.name: convert(p, value) for p, value in by_parameter}
        return {name: converted[name] for name in self.names if name in converted}


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return a message about an unknown `name`, with the closest known names or all of them.

    Examples
    --------
    >>> unknown_name("key", "forse_n", ["force_n", "plate_distance_mm"])
    "unknown key 'forse_n': did you mean 'force_n'?"
    """
    known = list(known)
    lower = {candidate.lower(): candidate for candidate in known}
    close = get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    with_unit = [candidate for candidate in lower if candidate.startswith(f"{name.lower()}_")]
    close = close or (with_unit if len(with_unit) == 1 else [])
    if close:
        return f"unknown {kind} {name!r}: did you mean {lower[close[0]]!r}?"
    return f"unknown {kind} {name!r}: known are {', '.join(known) or 'none'}"


def _stiffness(
    name: str,
    low_kpa: float,
    high_kpa: float,
    neutral_kpa: float | None,
    description: str,
    *,
    zero: bool = False,
    follows: str = "",
) -> Parameter:
    return Parameter(
        name,
        KPA,
        KPA.to_inside(low_kpa),
        KPA.to_inside(high_kpa),
        None if neutral_kpa is None else KPA.to_inside(neutral_kpa),
        description,
        open_lower=not zero,
        follows=follows,
    )


# Intervals and neutral values: thesis section 4.5, its first and third targets; the
# interval of muscle, which the thesis does not search, covers resting to tense.
BREAST = Vocabulary(
    [
        _stiffness("E_fat", 5, 20, 10, "Young's modulus of fat and ligaments"),
        _stiffness("eta_fat", 50, 200, 100, "fibre stiffness of fat and ligaments", zero=True),
        _stiffness("E_glandular", 5, 80, 40, "Young's modulus of gland"),
        _stiffness("eta_glandular", 50, 200, 150, "fibre stiffness of gland", zero=True),
        _stiffness("E_skin", 200, 3000, 1600, "Young's modulus of skin"),
        Parameter("nu", NUMBER, 0.45, 0.499, 0.49, "Poisson's ratio", admissible=(0.0, 0.5)),
        _stiffness("E_muscle", 5, 200, None, "Young's modulus of muscle", follows="E_fat"),
        _stiffness(
            "eta_muscle", 50, 200, None, "fibre stiffness of muscle", zero=True, follows="eta_fat"
        ),
    ]
)

"""Parameters of the model, their units, and readable values; shared by studies and reports.

The forward model is one parametric family. A study frees some parameters and
holds the others at given or neutral values. An effect adds its own parameters,
whose neutral values change nothing, by `Vocabulary.extended_by`.

Units are mm, N, MPa and s inside, and the users' in files and other interfaces. There the unit is
part of a parameter's name (its interface name), ``E_fat_kpa: 10``; the internal name and value
are ``E_fat`` = 0.01 MPa. Numbers are converted by one multiplication or division by an exact
factor, so that 10 kPa is always 0.01 MPa to the last bit.

A parameter is computed in the form that suits the fit, such as the logarithm of a ratio. Its
`Reading` defines the form in which the value, its interval and its neutral value are shown:
"0.75 times gravity", "nu = 0.45".
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from typing import Literal, TypeVar

from palpate.storage.errors import InputError


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of an interface.

    Parameters
    ----------
    symbol : str
        Printed symbol, such as "kPa"; empty for a pure number.
    inside : str
        Unit of the same quantity inside `workers`.
    per_inside : float
        Number of these units in one internal unit; exact in floating point.
    inside_per : float
        For a unit larger than the internal one: number of internal units in one of these. One of
        the two factors is 1, because a thousand is exact and a thousandth is not.

    Examples
    --------
    >>> KPA.to_inside(10.0)
    0.01
    >>> KPA.to_door(0.01)
    10.0
    >>> KPA.name_at_door("E_fat")
    'E_fat_kpa'
    >>> MM_PER_KPA.name_at_door("wall_compliance")
    'wall_compliance_mm_per_kpa'
    """

    symbol: str
    inside: str
    per_inside: float
    inside_per: float = 1.0

    def to_inside(self, value: float) -> float:
        """Convert from this unit to the internal unit."""
        return value * self.inside_per / self.per_inside

    def to_door(self, value: float) -> float:
        """Convert from the internal unit to this one."""
        return value * self.per_inside / self.inside_per

    def name_at_door(self, name: str) -> str:
        """Return `name` followed by its unit, as in files."""
        return f"{name}_{self.symbol.lower().replace('/', '_per_')}" if self.symbol else name

    def text(self, value_inside: float) -> str:
        """Format a value for display, such as "10 kPa"."""
        return f"{self.to_door(value_inside):g} {self.symbol}".rstrip()


KPA = Unit("kPa", "MPa", 1000.0)
PA = Unit("Pa", "MPa", 1e6)
MMHG = Unit("mmHg", "MPa", 1.0, 1.33322387e-4)
NUMBER = Unit("", "", 1.0)
N = Unit("N", "N", 1.0)
MM = Unit("mm", "mm", 1.0)
DEGREE = Unit("deg", "deg", 1.0)
G = Unit("g", "g", 1.0)  # multiples of the acceleration of gravity
KPA_PER_MM = Unit("kPa/mm", "MPa/mm", 1000.0)
MM_PER_KPA = Unit("mm/kPa", "mm/MPa", 1.0, 1000.0)
N_PER_M = Unit("N/m", "N/mm", 1000.0)

FORCE_UNITS = frozenset({KPA, PA, MMHG, G, N, KPA_PER_MM, MM_PER_KPA, N_PER_M})
"""Units of quantities that balance a force on a body: stiffness, pressure, weight."""


# Half the width of a 90 % interval of a normal distribution, in standard deviations.
NINETY_PERCENT = 1.6448536269514722


@dataclass(frozen=True, slots=True)
class Reading:
    """Form in which the value of a parameter is shown.

    Parameters
    ----------
    kind : {"as is", "ratio", "percent", "poisson"}
        The value in its unit; the ratio whose logarithm it is; a share in per cent; or
        Poisson's ratio nu, if the value is the logarithm of a change of 1 - 2 nu.
    unit : str
        Words after the number, such as "times gravity"; "" for the unit of the parameter.
    name : str
        Symbol before the number, such as "nu".
    """

    kind: Literal["as is", "ratio", "percent", "poisson"] = "as is"
    unit: str = ""
    name: str = ""


@dataclass(frozen=True, slots=True)
class ShownMagnitude:
    """Value with its 90 % interval in readable form; `neutral` is the model's value.

    `neutral` is None for the place of an effect, which the model does not have.
    """

    value: float
    low: float
    high: float
    neutral: float | None
    unit: str
    name: str = ""


AS_IS = Reading()


def ratio(unit: str) -> Reading:
    """Return the reading of the logarithm of a ratio."""
    return Reading("ratio", unit)


def percent(unit: str) -> Reading:
    """Return the reading of a share."""
    return Reading("percent", unit)


def poisson(name: str = "nu") -> Reading:
    """Return the reading of the logarithm of a change of 1 - 2 nu."""
    return Reading("poisson", "times the model's 1 − 2 nu", name)


def shown(
    reading: Reading,
    value: float,
    sd: float,
    neutral: float,
    unit: str,
    nu: float | None = None,
    least: float = -math.inf,
) -> ShownMagnitude:
    """Return a value with its 90 % interval in readable form.

    Parameters
    ----------
    reading : Reading
    value, sd, neutral, least : float
        In interface units; values below `least` are meaningless.
    unit : str
        Symbol of the parameter's unit.
    nu : float, optional
        Poisson's ratio of the model; without it, a change of 1 - 2 nu is shown as a ratio.

    Examples
    --------
    >>> change = shown(poisson(), 1.609437912, 0.2, 0.0, "", nu=0.49)
    >>> round(change.value, 3), round(change.low, 3), change.neutral, change.name
    (0.45, 0.431, 0.49, 'nu')
    >>> round(shown(ratio("times gravity"), 0.0, 0.1, 0.0, "").high, 3)
    1.179
    """
    half = NINETY_PERCENT * sd
    ends = max(value - half, least), value + half
    as_nu = reading.kind == "poisson" and nu is not None
    low, high = sorted(_converted(reading, end, nu) for end in ends)
    return ShownMagnitude(
        _converted(reading, value, nu),
        low,
        high,
        _converted(reading, neutral, nu),
        "" if as_nu else reading.unit or unit,
        reading.name if as_nu or reading.kind == "as is" else "",
    )


def shown_change(reading: Reading, size: float, unit: str) -> tuple[float, str]:
    """Return the size of a change from the neutral value, and its unit.

    Changes in a ratio, and in 1 - 2 nu, are in per cent.

    Examples
    --------
    >>> shown_change(percent("% lost"), 0.25, ""), shown_change(AS_IS, 2.0, "mm")
    ((25.0, '%'), (2.0, 'mm'))
    """
    if reading.kind == "as is":
        return size, unit
    return 100 * (size if reading.kind == "percent" else math.expm1(size)), "%"


def _converted(reading: Reading, value: float, nu: float | None) -> float:
    if reading.kind == "as is":
        return value
    if reading.kind == "percent":
        return 100 * value
    factor = math.exp(min(value, 700.0))
    if reading.kind == "poisson" and nu is not None:
        return (1 - (1 - 2 * nu) * factor) / 2
    return factor


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

    @property
    def limit(self) -> float | None:
        """Return the physical limit: the least admissible value; None if it is excluded.

        Examples
        --------
        >>> BREAST["eta_fat"].limit, BREAST["E_fat"].limit, BREAST["nu"].limit
        (0.0, None, None)
        """
        low = self.admissible[0]
        return low if math.isfinite(low) and not self.open_lower else None

    @property
    def door_limit(self) -> float | None:
        """Return `limit` in the unit of files."""
        return None if self.limit is None else self.unit.to_door(self.limit)

    def admits(self, value: float) -> bool:
        """Test whether a value is admissible."""
        low, high = self.admissible
        above = value > low if self.open_lower else value >= low
        return math.isfinite(value) and above and value < high

    def either_side(self, value: float, step: float) -> tuple[float, float]:
        """Return the values a step above and below; a value itself for an inadmissible side.

        Examples
        --------
        >>> BREAST["E_fat"].either_side(0.01, 0.005), BREAST["eta_fat"].either_side(0.0, 0.005)
        ((0.015, 0.005), (0.005, 0.0))
        """
        above, below = (v if self.admits(v) else value for v in (value + step, value - step))
        return above, below

    def check(self, value: float) -> float:
        """Return `value` as a float if it is admissible.

        Raises
        ------
        InputError
            If it is not.
        """
        if not self.admits(value):
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

    def side_text(self, *, lower: bool) -> str:
        """Return the admissible values on one side, as ``at least 0 kPa``; empty if any are.

        Examples
        --------
        >>> BREAST["nu"].side_text(lower=False), BREAST["eta_fat"].side_text(lower=True)
        ('below 0.5', 'at least 0 kPa')
        """
        bound = self.unit.to_door(self.admissible[0 if lower else 1])
        if not math.isfinite(bound):
            return ""
        words = ("above" if self.open_lower else "at least") if lower else "below"
        return f"{words} {bound:g} {self.unit.symbol}".rstrip()

    def _range_text(self) -> str:
        parts = (self.side_text(lower=lower) for lower in (True, False))
        return " and ".join(filter(None, parts)) or "a finite number"


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
        return tuple(self._by_door_name)

    def at_door(self, door_name: str) -> Parameter:
        """Return the parameter with this name in a study file.

        Raises
        ------
        InputError
            If there is none; close names are suggested.
        """
        try:
            return self._by_door_name[door_name]
        except KeyError:
            raise InputError(unknown_name("parameter", door_name, self.door_names)) from None

    @cached_property
    def _by_door_name(self) -> dict[str, Parameter]:
        return {parameter.door_name: parameter for parameter in self}

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
            values, lambda p, b: p.check_bounds((p.unit.to_inside(b[0]), p.unit.to_inside(b[1])))
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


def _stiffness_parameter(
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
        _stiffness_parameter("E_fat", 5, 20, 10, "Young's modulus of fat and ligaments"),
        _stiffness_parameter(
            "eta_fat", 50, 200, 100, "fibre stiffness of fat and ligaments", zero=True
        ),
        _stiffness_parameter("E_glandular", 5, 80, 40, "Young's modulus of gland"),
        _stiffness_parameter("eta_glandular", 50, 200, 150, "fibre stiffness of gland", zero=True),
        _stiffness_parameter("E_skin", 200, 3000, 1600, "Young's modulus of skin"),
        Parameter("nu", NUMBER, 0.45, 0.499, 0.49, "Poisson's ratio", admissible=(0.0, 0.5)),
        _stiffness_parameter(
            "E_muscle", 5, 200, None, "Young's modulus of muscle", follows="E_fat"
        ),
        _stiffness_parameter(
            "eta_muscle", 50, 200, None, "fibre stiffness of muscle", zero=True, follows="eta_fat"
        ),
    ]
)

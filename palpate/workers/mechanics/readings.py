"""Readable values of parameters: "0.75 times gravity", "nu = 0.45".

A parameter is computed in the form that suits the fit, such as the logarithm of a ratio. Its
`Reading` defines the form in which the value, its interval and its neutral value are shown.
"""

import math
from dataclasses import dataclass
from typing import Literal

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

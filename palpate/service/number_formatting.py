"""Numbers, names and quantities with units, formatted for readers and for JSON.

As JSON a constant is ``{"value": 10.0, "unit": "kPa"}`` under its name in a study file. Other
numbers have a unit suffix in their name.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from palpate.workers.mechanics.model_parameters import Vocabulary

MINUS = "\u2212"
NARROW = "\u202f"
NONE = "\u2013"
# Larger numbers are written with a power of ten.
HUGE = 1e12

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GREEK = {"eta": "η", "nu": "ν", "E": "E", "compressibility": "1 − 2ν"}


def number(value: float | None, digits: int = 4) -> str:
    """Format a number with significant digits, a typographic minus and no trailing zeros.

    Examples
    --------
    >>> number(10.1234), number(12345678.0), number(float("inf")), number(None)
    ('10.12', '12345678', '∞', '–')
    >>> number(-1.2e-10), number(5.27e18), number(99.6, 2)
    ('−1.20·10⁻¹⁰', '5.27·10¹⁸', '100')
    """
    if value is None or math.isnan(value):
        return NONE
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    size = abs(value)
    if 10**digits <= size < HUGE:
        text = f"{value:.0f}"
    elif size and not 1e-3 <= size < HUGE:
        mantissa, exponent = f"{value:.{digits - 2}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"
    else:
        text = f"{value:.{digits}g}"
        text = f"{value:.0f}" if "e" in text else text  # 99.6 with two digits is 100, not 1e+02
    return text.replace("-", MINUS)


def count(value: int) -> str:
    """Format an integer with thin spaces between thousands.

    Examples
    --------
    >>> count(1260).replace(NARROW, " ")
    '1 260'
    """
    return f"{value:,}".replace(",", NARROW).replace("-", MINUS)


def percent(share: float | None, digits: int = 1) -> str:
    """Format a signed relative error.

    Examples
    --------
    >>> percent(0.0123), percent(-0.2), percent(-0.0001), percent(None)
    ('+1.2 %', '−20.0 %', '0.0 %', '–')
    """
    if share is None:
        return NONE
    size = f"{abs(100 * share):.{digits}f}"
    if not float(size):
        return f"{size} %"
    return f"{'+' if share > 0 else MINUS}{size} %"


def small_percent(share_of: float | None) -> str:
    """Format a signed relative error, with more digits instead of 0.0 %.

    Examples
    --------
    >>> small_percent(0.0123), small_percent(-0.0003), small_percent(0.0)
    ('+1.2 %', '−0.03 %', '0.0 %')
    """
    text = percent(share_of)
    if not share_of or text != "0.0 %":
        return text
    return f"{'+' if share_of > 0 else ''}{share(share_of)}"


def beside(estimate: float | None, target: float | None) -> str:
    """Format an estimate with the digits that tell it from its target: three to six.

    Examples
    --------
    >>> beside(10.12, 10.0), beside(9.997, 10.0), beside(10.0, 10.0), beside(0.0, None)
    ('10.1', '9.997', '10', '0')
    """
    if estimate is None or target is None or estimate == target:
        return number(estimate, 3)
    texts = [(number(estimate, digits), number(target, digits)) for digits in range(3, 7)]
    return next((own for own, other in texts if own != other), texts[0][0])


def share(part: float) -> str:
    """Format a fraction as per cent with two significant digits, or all integer digits.

    Examples
    --------
    >>> share(1.5), share(0.0996), share(0.00123), share(-0.25), share(0.0)
    ('150 %', '10 %', '0.12 %', '−25 %', '0 %')
    """
    return f"{number(100 * part, 2)} %"


def duration(seconds: float) -> str:
    """Format a time span.

    Examples
    --------
    >>> duration(0.0123), duration(42.3), duration(3700), duration(200_000)
    ('12.3 ms', '42.3 s', '1 h 1 min', '2 d 7 h')
    """
    if seconds < 1:
        return f"{1000 * seconds:.3g} ms"
    if seconds < 100:
        return f"{seconds:.3g} s"
    minutes, hours, days = seconds / 60, seconds / 3600, seconds / 86400
    if minutes < 60:
        return f"{int(minutes)} min {int(seconds % 60)} s"
    if days < 1:
        return f"{int(hours)} h {int(minutes % 60)} min"
    return f"{int(days)} d {int(hours % 24)} h"


def bare(name: str, unit: str) -> str:
    """Return the name of a parameter without its unit suffix.

    Examples
    --------
    >>> bare("E_fat_kpa", "kPa"), bare("nu", ""), bare("E_fat", "kPa")
    ('E_fat', 'nu', 'E_fat')
    """
    ending = f"_{unit.lower()}"
    return name[: -len(ending)] if unit and name.endswith(ending) else name


def label(name: str, unit: str) -> str:
    """Format the name of a parameter for an axis.

    Examples
    --------
    >>> label("eta_fat_kpa", "kPa")
    'η fat, kPa'
    """
    head, _, tail = bare(name, unit).partition("_")
    text = f"{_GREEK.get(head, head)} {tail.replace('_', ' ')}".strip()
    return f"{text}, {unit}" if unit else text


def symbol(name: str, unit: str = "") -> Markup:
    """Format the name of a parameter for running text.

    Examples
    --------
    >>> symbol("E_fat_kpa", "kPa")
    Markup('<i>E</i><sub>fat</sub>')
    >>> symbol("compressibility_rubber")
    Markup('<i>1 − 2ν</i><sub>rubber</sub>')
    """
    head, _, tail = bare(name, unit).partition("_")
    below = Markup("<sub>{}</sub>").format(tail.replace("_", " ")) if tail else Markup("")
    return Markup("<i>{}</i>").format(_GREEK.get(head, head)) + below


def joined(items: list[Any]) -> Markup:
    """Join items with commas, and "and" before the last."""
    parts = [escape(item) for item in items]
    if len(parts) < 2:
        return Markup("").join(parts)
    return Markup(", ").join(parts[:-1]) + Markup(" and ") + parts[-1]


def listed(items: Sequence[str], last: str = "and") -> str:
    """Return items as plain text with commas, and a word before the last one.

    Examples
    --------
    >>> listed(["a", "b", "c"]), listed(["a", "b"], "or")
    ('a, b and c', 'a or b')
    """
    return f" {last} ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def at_edge(estimate: float, bounds: tuple[float, float], share: float = 0.01) -> bool:
    """Check whether an estimate is so close to a bound that the bound may determine it."""
    low, high = bounds
    return min(estimate - low, high - estimate) < share * (high - low)


def signed_error(estimate: float | None, target: float | None) -> float | None:
    """Return estimate / target - 1; None if one is missing or the target is zero."""
    return estimate / target - 1 if estimate is not None and target else None


# Unit suffixes of names, longest first.
SUFFIXES = {"_mm2": "mm2", "_mm": "mm", "_mj": "mJ", "_ml": "ml", "_kpa": "kPa", "_n": "N"}


class Quantity(NamedTuple):
    """A number and its unit in files, "" for a pure number."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.6g} {self.unit}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """Return the record that ``--json`` prints."""
        return {"value": self.value, "unit": self.unit}


def quantities_at_door(vocabulary: Vocabulary, genes: Mapping[str, float]) -> dict[str, Quantity]:
    """Return parameters, with the names and values of a study file, as quantities."""
    return {
        name: Quantity(value, vocabulary.at_door(name).unit.symbol) for name, value in genes.items()
    }


def quantities_inside(
    vocabulary: Vocabulary, constants: Mapping[str, float]
) -> dict[str, Quantity]:
    """Return constants with internal names and units (E_fat, MPa) as in a study file."""
    return {
        vocabulary[name].door_name: Quantity(
            vocabulary[name].unit.to_door(value), vocabulary[name].unit.symbol
        )
        for name, value in constants.items()
    }


def not_neutral(
    vocabulary: Vocabulary, constants: Mapping[str, float], stated: Collection[str] = ()
) -> dict[str, float]:
    """Return the constants that are given or differ from their neutral values.

    Parameters
    ----------
    vocabulary : Vocabulary
    constants : mapping of str to float
        By internal name; one that follows another is neutral if the values are equal.
    stated : collection of str
        Internal names that are always kept.
    """

    def neutral(name: str) -> float:
        parameter = vocabulary[name]
        return constants[parameter.follows] if parameter.neutral is None else parameter.neutral

    return {
        name: value for name, value in constants.items() if name in stated or value != neutral(name)
    }


def quantities_json(quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """Return quantities as the record that ``--json`` prints."""
    return {name: quantity.as_json() for name, quantity in quantities.items()}


def named_quantity(name: str, value: Any) -> tuple[str, str]:
    """Return the name and text of a value with a unit suffix in its name.

    Examples
    --------
    >>> named_quantity("plate_force_n", 100.0)
    ('plate_force', '100 N')
    >>> named_quantity("cg_iterations", [3, 4])
    ('cg_iterations', '3, 4')
    """
    if isinstance(value, list | tuple):
        return name, ", ".join(map(str, value))
    if isinstance(value, bool):
        return name, "yes" if value else "no"
    suffix = next((s for s in SUFFIXES if name.endswith(s)), "")
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return name.removesuffix(suffix), f"{text} {SUFFIXES.get(suffix, '')}".rstrip()

"""Magnitudes and lengths as text, rounded according to their uncertainty."""

import math
from typing import Protocol

from palpate.service.number_formatting import MINUS, NONE, number
from palpate.workers.diagnosis.outcome.diagnosis_summary import EffectSummary, ParameterEstimate
from palpate.workers.mechanics.model_parameters import ShownMagnitude

MOST_DIGITS = 4
# The smallest printed upper limit of a gap; the noise level if that is smaller.
LEAST_MM = 0.01


def measured(value: float | None, sd: float | None, unit: str) -> str:
    """Return a magnitude with its standard deviation as text.

    Examples
    --------
    >>> measured(5.4838, 0.2712, "deg"), measured(-16.57, 1.04, "mm"), measured(None, None, "g")
    ('5.48 ± 0.27 deg', '−16.6 ± 1.0 mm', '–')
    """
    if value is None or sd is None:
        return NONE
    digits = rounding(sd)
    if digits > MOST_DIGITS:
        return f"{number(value, 3)} ± {number(sd, 2)} {unit}".rstrip()
    return f"{signed(value, digits)} ± {sd:.{digits}f} {unit}".rstrip()


def magnitude(one: ParameterEstimate | EffectSummary) -> str:
    """Return a magnitude as text, with its 90 % interval and the model's value.

    Examples
    --------
    >>> nu = ShownMagnitude(0.4503, 0.431, 0.462, 0.49, "", "nu")
    >>> magnitude(ParameterEstimate("ln_compressibility", 1.6, 0.2, "", nu))
    'nu = 0.45 (0.43 to 0.46; model: 0.49)'
    >>> magnitude(ParameterEstimate("tilt_depth_deg", 5.4838, 0.2712, "deg"))
    '5.48 ± 0.27 deg'
    """
    if one.shown is None:
        return measured(one.magnitude, one.sd, one.unit)
    value, *detail = shown_parts(one.shown)
    return f"{value} ({'; '.join(detail)})"


def shown_parts(one: ShownMagnitude) -> list[str]:
    """Return a value with its unit, its interval and the model's value."""
    digits = rounding((one.high - one.low) / 3, figures=1)

    def text(value: float) -> str:
        return number(value, 2) if digits > MOST_DIGITS else signed(value, digits)

    name = f"{one.name} = " if one.name else ""
    model = [] if one.neutral is None else [f"model: {number(one.neutral, 4)}"]
    value = f"{name}{text(one.value)} {one.unit}".rstrip()
    return [value, f"{text(one.low)} to {text(one.high)}", *model]


def difference(value: float, sd: float) -> str:
    """Return a signed number, rounded according to its standard deviation.

    Examples
    --------
    >>> difference(-0.0123, 0.02), difference(0.25, 0.1), difference(2.1e-6, 1e-6)
    ('−0.012', '+0.25', '+2·10⁻⁶')
    """
    digits = rounding(sd)
    if digits > MOST_DIGITS:
        return ("+" if value > 0 else "") + number(value, 2)
    return signed(value, digits, "+")


def rounding(sd: float, figures: int = 2) -> int:
    """Return the decimals that show the given significant digits of a standard deviation."""
    return max(0, figures - 1 - math.floor(math.log10(sd))) if sd > 0 else 3


def signed(value: float, digits: int, plus: str = "") -> str:
    """Return a number with a typographic minus, not before zero; `plus` "+" adds a plus sign.

    Examples
    --------
    >>> signed(-0.254, 2), signed(-0.001, 2), signed(0.25, 2, "+")
    ('−0.25', '0.00', '+0.25')
    """
    rounded = round(value, digits) + 0.0
    text = f"{rounded:{plus if rounded else ''}.{digits}f}"
    return text.replace("-", MINUS)


class Interval(Protocol):
    """A length with its interval, in mm."""

    @property
    def gap_mm(self) -> float:
        """Central value."""

    @property
    def low_mm(self) -> float:
        """Lower end."""

    @property
    def high_mm(self) -> float:
        """Upper end."""


def millimetres(gap: Interval | None) -> str:
    """Return a gap with its interval as text.

    Examples
    --------
    >>> from palpate.workers.diagnosis.outcome.diagnosis_summary import GapEstimate
    >>> millimetres(GapEstimate(0.2684, 0.2256, 0.305, 0.44, 8))
    '0.27 mm (0.23 to 0.30)'
    """
    if gap is None:
        return NONE
    middle, low, high = (length(v, gap.high_mm) for v in (gap.gap_mm, gap.low_mm, gap.high_mm))
    return f"{middle} mm ({low} to {high})"


def length(mm: float, beside: float | None = None) -> str:
    """Return a length in mm with two decimals.

    Use two significant digits if it or the length shown next to it is smaller than that.

    Examples
    --------
    >>> length(0.2684), length(0.0), length(0.00123), length(0.00004, beside=0.00123)
    ('0.27', '0.00', '0.0012', '0.0000')
    """
    digits = decimals(mm if beside is None else beside)
    return number(mm, 2) if digits > MOST_DIGITS + 1 else f"{mm:.{digits}f}"


def decimals(mm: float) -> int:
    """Return the number of decimals: two, or two significant digits of a smaller length."""
    return rounding(mm) if 0 < mm < LEAST_MM else 2

"""Comparison of one number of the thesis with ours, and its verdict."""

import math
from dataclasses import dataclass
from typing import Literal

from palpate.service.formatting import number

Word = Literal["reproduced", "approached", "not reproduced", "cannot be", "not run"]
# A number is reproduced within 10 %, or if less is better and it is not larger; approached
# within a factor of two.
SAME, NEAR = 0.10, 2.0
ROUNDING = 1e-9


@dataclass(frozen=True)
class Verdict:
    """One number of the thesis.

    Parameters
    ----------
    place : str
        Where it is in the thesis.
    what : str
    printed, found : str
        Formatted values.
    word : str
    reason : str
        Why it differs from the printed one.
    """

    place: str
    what: str
    printed: str
    found: str
    word: Word
    reason: str = ""


def equal(
    place: str, what: str, wanted: float, found: float | None, unit: str = "", why: str = ""
) -> Verdict:
    """Return the verdict on a number that should be equal; None and nan mean not run."""
    ratio = math.inf
    if found is not None and found > 0:
        ratio = max(found / wanted, wanted / found)
    return _compared(place, what, wanted, found, unit, why, ratio, 1 + SAME)


def at_most(
    place: str, what: str, wanted: float, found: float | None, unit: str = "", why: str = ""
) -> Verdict:
    """Return the verdict on a number for which less is better; None and nan mean not run."""
    ratio = math.inf if found is None else found / wanted
    return _compared(place, what, wanted, found, unit, why, ratio, 1 + ROUNDING)


def holds(
    place: str, what: str, wanted: str, good: bool | None, found: str, why: str = ""
) -> Verdict:
    """Return the verdict on a statement; None means not run."""
    if good is None:
        return Verdict(place, what, wanted, "–", "not run")
    if good:
        return Verdict(place, what, wanted, found, "reproduced")
    return Verdict(place, what, wanted, found, "not reproduced", why)


def with_unit(value: float, unit: str) -> str:
    """Return a number of a table as text; a fraction as per cent."""
    if unit == "%":
        return f"{number(100 * value, 3)} %"
    return f"{number(value, 4)} {unit}".strip()


def _compared(
    place: str,
    what: str,
    wanted: float,
    found: float | None,
    unit: str,
    why: str,
    ratio: float,
    same: float,
) -> Verdict:
    if found is None or math.isnan(found):
        return Verdict(place, what, with_unit(wanted, unit), "–", "not run")
    texts = with_unit(wanted, unit), with_unit(found, unit)
    if ratio <= same:
        return Verdict(place, what, *texts, "reproduced")
    word: Word = "approached" if ratio <= NEAR else "not reproduced"
    return Verdict(place, what, *texts, word, why)

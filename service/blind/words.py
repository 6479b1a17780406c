"""Figures, truths and answers as a reader wants them."""

from service.blind.records import CaseRecord
from service.blind.scores import Figure, Unit
from service.diagnosis.words import NOT_EFFECTS, likely, signed, spoken, together
from service.report.words import NONE


def shown(value: float | None, unit: Unit) -> str:
    """A value with its unit.

    Examples
    --------
    >>> shown(0.95, "share"), shown(0.0412, "mm"), shown(-0.5, "number"), shown(None, "mm")
    ('95 %', '0.041 mm', '−0.50', '–')
    """
    if value is None:
        return NONE
    if unit == "share":
        return f"{100 * value:.0f} %"
    return f"{value:.3f} mm" if unit == "mm" else signed(value, 2)


def limit(figure: Figure) -> str:
    """A target in words.

    Examples
    --------
    >>> from service.blind.scores import Target
    >>> from service.blind.statistics import NOTHING
    >>> limit(Figure("k", "t", NOTHING, "share", Target(0.9, True), None))
    'at least 90 %'
    """
    if figure.target is None:
        return ""
    word = "at least" if figure.target.at_least else "at most"
    return f"{word} {shown(figure.target.value, figure.unit)}"


def interval(figure: Figure) -> str:
    """The interval of a figure; empty where there is none."""
    found = figure.estimate
    if found.low is None or found.high is None or found.low >= found.high:
        return ""
    return f"{shown(found.low, figure.unit)} to {shown(found.high, figure.unit)}"


def asked_for(record: CaseRecord) -> str:
    """What is true of a case."""
    return together(record.effects) if record.effects else spoken(record.kind)


def answered(record: CaseRecord) -> str:
    """What was said of a case."""
    if record.answer == "failed":
        return "failed"
    if not record.primary:
        return spoken(record.answer)
    first = f"{together(record.primary)} ({likely(record.probabilities[record.primary[0]])})"
    if record.answer == "effect":
        return first
    others = [n for n in record.set90 if n not in record.primary and n not in NOT_EFFECTS]
    return f"{first}, or {together(others)}" if others else f"{first}, not for certain"


def millimetres(value: float | None) -> str:
    """A gap without its interval."""
    return NONE if value is None else f"{value:.2f}"

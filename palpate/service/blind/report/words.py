"""Metrics, truths and answers as text."""

from palpate.service.blind.scoring.metrics import Metric, Unit
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.diagnosis.words import NOT_EFFECTS, likely, signed, spoken, together
from palpate.service.formatting import NONE


def shown(value: float | None, unit: Unit) -> str:
    """Return a value with its unit.

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


def limit(metric: Metric) -> str:
    """Return a target as text.

    Examples
    --------
    >>> from palpate.service.blind.scoring.metrics import Target
    >>> from palpate.service.blind.scoring.statistics import NOTHING
    >>> limit(Metric("k", "t", NOTHING, "share", Target(0.9, True), None))
    'at least 90 %'
    """
    if metric.target is None:
        return ""
    word = "at least" if metric.target.at_least else "at most"
    return f"{word} {shown(metric.target.value, metric.unit)}"


def interval(metric: Metric) -> str:
    """Return the interval of a metric as text; empty if there is none."""
    estimate = metric.estimate
    if estimate.low is None or estimate.high is None or estimate.low >= estimate.high:
        return ""
    return f"{shown(estimate.low, metric.unit)} to {shown(estimate.high, metric.unit)}"


def asked_for(record: CaseRecord) -> str:
    """Return the truth of a case as text."""
    return together(record.effects) if record.effects else spoken(record.kind)


def answered(record: CaseRecord) -> str:
    """Return the answer to a case as text."""
    if record.answer == "failed":
        return "failed"
    if not record.primary:
        return spoken(record.answer)
    first = f"{together(record.primary)} ({likely(record.probabilities[record.primary[0]])})"
    if record.answer == "effect":
        return first
    others = [n for n in record.set90 if n not in record.primary and n not in NOT_EFFECTS]
    return f"{first}, or {together(others)}" if others else f"{first}, uncertain"


def millimetres(value: float | None) -> str:
    """Return a gap without its interval."""
    return NONE if value is None else f"{value:.2f}"

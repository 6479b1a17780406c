"""Whether the constants of a diagnosis may be quoted."""

from dataclasses import dataclass
from typing import Any

from palpate.service.number_formatting import number, signed_error
from palpate.service.results.identification import WEAK_PART
from palpate.service.results.physical_limits import Bounds
from palpate.service.results.quotability_rule import (
    EstimateFacts,
    IdentifiedAs,
    Quotability,
    quotability,
    reason_lines,
)
from palpate.storage.json_digests import to_json
from palpate.workers.diagnosis.outcome.diagnosis_summary import ConstantEstimate, Summary

# Smaller changes in a constant due to an effect are ignored.
SAME = 0.05
KPA_ENDING = "_kpa"


@dataclass(frozen=True)
class JudgedConstant:
    """A constant of a diagnosis, fitted with the named effects if there are any.

    Parameters
    ----------
    value : float
        In `unit`.
    unit : str
    interval : (float, float) or None
        90 % interval; None if it is unknown or withheld.
    answer : Quotability
        Quotability of `value`.
    """

    value: float
    unit: str
    interval: Bounds | None
    answer: Quotability

    @property
    def text(self) -> str:
        """Return the value with its interval and unit, such as ``8.1 (7.7 to 8.5) kPa``."""
        if not self.answer.estimated:
            return "no estimate"
        ends = self.interval
        shown = "" if ends is None else f" ({number(ends[0], 3)} to {number(ends[1], 3)})"
        return f"{number(self.value, 3)}{shown} {self.unit}".rstrip()


def judged_constants(summary: Summary) -> dict[str, JudgedConstant]:
    """Return each constant of a diagnosis with its interval and quotability, by name."""
    return {name: _judged(summary, name, one) for name, one in summary.constants.items()}


def summary_json(summary: Summary) -> dict[str, Any]:
    """Return the record of `palpate diagnose --json`, with the quotability of constants."""
    record: dict[str, Any] = to_json(summary)
    record["shrinkage"] = {"checked_on": summary.gap_mm.checked_on}
    for name, one in judged_constants(summary).items():
        record["constants"][name] |= one.answer.as_dict()
    return record


def unit_of(name: str) -> str:
    """Return the unit in the name of a constant; empty for a pure number."""
    return "kPa" if name.endswith(KPA_ENDING) else ""


def change(constant: ConstantEstimate) -> float:
    """Return the relative change in a constant due to the named effects; 0 if unknown."""
    found = signed_error(constant.after, constant.before)
    return 0.0 if found is None else abs(found)


def is_lead(summary: Summary) -> bool:
    """Check whether the effect may not reduce the gap on held-out scans.

    An effect that was only checked on the scan that it was fitted to is a lead as well.
    """
    share = summary.gap_mm.held_out_share
    return summary.gap_mm.checked_on == "same scan" or (share is not None and share.low < 0)


def _judged(summary: Summary, name: str, constant: ConstantEstimate) -> JudgedConstant:
    changed = constant.after is not None and summary.verdict != "no-gap"
    value = constant.after if changed and constant.after is not None else constant.before
    interval = constant.after_interval if changed else constant.before_interval
    facts = EstimateFacts(
        value=value,
        unit=unit_of(name),
        stated=constant.stated,
        interval=interval,
        identifiable=_identifiable(value, interval),
        converged=constant.converged is not False,
        no_better_than="the undeformed body" if summary.gap_mm.fits_no_better_than_rest else "",
        contradictions=_contradictions(summary, constant),
    )
    answer = quotability(facts)
    shown = interval if answer.interval_holds else None
    return JudgedConstant(value, facts.unit, shown, answer)


def _identifiable(value: float, interval: Bounds | None) -> IdentifiedAs:
    if interval is None:
        return "unknown"
    return "weak" if interval[1] - interval[0] > WEAK_PART * abs(value) else "value"


def _contradictions(summary: Summary, constant: ConstantEstimate) -> tuple[str, ...]:
    """Return the verdict's reasons against quoting a constant."""
    if summary.verdict == "no-gap":
        return ()
    if summary.verdict == "none-of-these" or summary.something_else:
        return ("the model lacks something that is not in the catalogue",)
    if constant.after is None:
        return ("the cause of the gap is undecided",)
    if constant.depends_on_law:
        return ("the slope at small strain depends on the law of the stiffening tissue",)
    uncertain = summary.verdict == "cannot-be-told-apart" or is_lead(summary)
    if uncertain and change(constant) >= SAME:
        return ("it depends on a cause that is not certain",)
    return ()


def constant_lines(summary: Summary) -> list[str]:
    """Return console lines for the constants, then the reasons against quoting some."""
    judged = judged_constants(summary)
    lines = [
        f"{name.removesuffix(KPA_ENDING)}: {constant.text}" + _without(summary, name)
        for name, constant in judged.items()
    ]
    answers = {name.removesuffix(KPA_ENDING): one.answer for name, one in judged.items()}
    return lines + reason_lines(answers)


def _without(summary: Summary, name: str) -> str:
    """Return the constant's value without the suspected effects, as a clause."""
    constant = summary.constants[name]
    if summary.verdict == "no-gap" or constant.after is None:
        return ""
    return f", without the named effects {number(constant.before, 3)} {unit_of(name)}".rstrip()

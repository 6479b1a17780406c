"""Consequences of a diagnosis: which constants may be quoted, and what to do next."""

from collections.abc import Mapping

from markupsafe import Markup

from palpate.service.diagnosis.diagnosed_constants import (
    SAME,
    JudgedConstant,
    change,
    is_lead,
    judged_constants,
)
from palpate.service.diagnosis.diagnosis_words import spoken, together
from palpate.service.number_formatting import joined, listed, percent, signed_error, symbol
from palpate.service.report.page.page_elements import quote_lines
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.scan_plan import REDRAWN


def quotable(summary: Summary) -> Markup:
    """Return a sentence on the constants that may and may not be quoted."""
    if not summary.constants:
        return Markup("")
    judged = judged_constants(summary)
    good = [
        Markup("{} = {}").format(symbol(name, "kPa"), constant.text)
        for name, constant in judged.items()
        if constant.answer.quotable
    ]
    answers = {symbol(name, "kPa"): constant.answer for name, constant in judged.items()}
    if not good:
        return quote_lines(Markup(""), answers)
    fitted = summary.primary if summary.verdict != "no-gap" else ()
    quote = Markup("Quote {}{}").format(
        joined(good), f", fitted with {together(fitted)}" if fitted else ""
    )
    said = quote_lines(quote, answers)
    return said + _of_nominal_model(summary, judged) + _hidden(summary)


def _of_nominal_model(summary: Summary, judged: Mapping[str, JudgedConstant]) -> Markup:
    """Return the errors of the nominal model's constants without the named effects."""
    changes = [
        Markup("{} {}").format(symbol(n, "kPa"), percent(signed_error(c.after, c.before), 0))
        for n, c in summary.constants.items()
        if judged[n].answer.quotable and change(c) >= SAME
    ]
    if summary.verdict == "no-gap" or not changes:
        return Markup("")
    return Markup(" Without {} the constants of the nominal model are off ({}).").format(
        together(summary.primary), joined(changes)
    )


def next_step(summary: Summary, command: str) -> Markup:
    """Return the next step; `command` is the command line, empty if unknown."""
    source = command.removeprefix("palpate diagnose").strip()
    if summary.verdict == "no-gap":
        return Markup("Nothing needs to be added to the model.")
    if summary.next_acquisitions:
        best = summary.next_acquisitions[0]
        pairs = [Markup("{} from {}").format(*map(spoken, pair)) for pair in best.separates]
        to = f", to distinguish {listed(pairs)}" if pairs else ""
        smaller = f": effects {best.minimum_ratio:.2f} times as large would show"
        verb = "Draw" if best.name == REDRAWN else "Measure"
        return Markup("{} {}{}.").format(verb, best.name, to or smaller)
    if summary.verdict == "cannot-be-told-apart" and summary.markers is None:
        return Markup(
            "Find the measurement that would distinguish the causes: <code>{}</code>"
        ).format(f"palpate plan {source}".strip())
    if summary.verdict == "none-of-these":
        return Markup(
            "Check where model and data differ most: are the {} and the load right there? Then "
            "go through the table of causes outside the catalogue."
        ).format("segmentation" if summary.markers is None else "measured points")
    if is_lead(summary):
        return Markup("Confirm {} with a scan under another load.").format(
            together(summary.primary)
        )
    return Markup("Add {} to the model, or measure it, and refit.").format(
        together(summary.primary)
    )


def _names(constants: object) -> Markup:
    return joined([symbol(n, "kPa") for n in constants])  # type: ignore[attr-defined]


def _hidden(summary: Summary) -> str:
    if not summary.absorbed:
        return ""
    return f" The constants may have absorbed {together(summary.absorbed)}."

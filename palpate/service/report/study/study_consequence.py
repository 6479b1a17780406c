"""Consequences of a study: which constants may be quoted, and what to do next."""

from collections.abc import Iterable

from markupsafe import Markup

from palpate.service.number_formatting import joined, number, symbol
from palpate.service.report.page.page_elements import quote_lines
from palpate.service.results.identification import Identification, IdentifiedConstant
from palpate.service.results.intervals import in_words
from palpate.service.results.quotability_rule import Quotability
from palpate.service.results.result_records import (
    DerivedEstimate,
    ParameterEstimate,
    StudyResults,
    derived_estimates,
    ratio_quotability,
)
from palpate.storage.values import TargetKind


def quotable(results: StudyResults) -> Markup:
    """Return a sentence on the constants that may and may not be quoted; empty if none."""
    if all(e.estimate is None and e.quotability is None for e in results.estimates.values()):
        return Markup("")
    known = results.identification
    if known is not None and known.ratios:
        return _said(_ratios(known, results), "Quote ratios only: {}") + Markup(
            " The plate distance is known but no force is given, so values in kPa cannot be "
            "determined."
        )
    answers = results.quotability
    constants = [
        (_with_interval(name, estimate, known, answers[name]), answers[name])
        for name, estimate in results.estimates.items()
    ]
    return _said(constants + [(_derived(d), d.answer) for d in derived_estimates(results)])


def _derived(one: DerivedEstimate) -> Markup:
    """Return a derived quantity, with value and interval if it may be quoted."""
    if not one.answer.quotable or one.interval is None:
        return Markup("{}").format(one.name)
    ends = f"{number(one.interval[0], 3)} to {number(one.interval[1], 3)}"
    return Markup("{} = {} ({}) {}").format(one.name, number(one.value, 3), ends, one.unit)


def _said(judged: list[tuple[Markup, Quotability]], quote: str = "Quote {}") -> Markup:
    """Return the values that may and may not be quoted, with reasons."""
    good = [name for name, answer in judged if answer.quotable]
    return quote_lines(Markup(quote).format(joined(good)) if good else Markup(""), dict(judged))


def _with_interval(
    name: str, estimate: ParameterEstimate, known: Identification | None, answer: Quotability
) -> Markup:
    """Return a constant, with value and interval if it may be quoted."""
    constant = None if known is None else known.constants.get(name)
    if not answer.quotable or constant is None or constant.interval is None:
        return _named(name, estimate)
    if estimate.one_sided:
        words = estimate.text.replace("(90 %)", f"(90 %, {estimate.limit_note})")
        return Markup("{} {}").format(_named(name, estimate), words)
    value = number(estimate.estimate, 3)
    ends = f"{number(constant.interval.lower, 3)} to {number(constant.interval.upper, 3)}"
    return Markup("{} = {} ({}){}").format(
        _named(name, estimate), value, ends, f" {estimate.unit}".rstrip()
    )


def next_step(results: StudyResults, target: TargetKind | None) -> Markup:
    """Return the next step, with its command."""
    if results.state == "running":
        return Markup("This page is updated after every generation.")
    if results.state == "interrupted":
        return _command("Continue the search:", f"palpate run {results.folder}")
    edges = [_edge(results, n, e) for n, e in results.estimates.items() if e.at_bound]
    if edges:
        return Markup(
            "Widen the searched interval of {} and run the study under another name."
        ).format(joined(edges))
    known = results.identification
    if known is not None and any(c.identifiable == "ratio" for c in known.constants.values()):
        return Markup(
            "Give the plate force, or hold one stiffness, to find values instead of ratios."
        )
    weak = [] if known is None else [n for n in known.weak if n in results.estimates]
    if weak:
        names = joined([_named(n, results.estimates[n]) for n in weak])
        words = Markup("Find out what the model lacks, and what would determine {} better:")
        return _command(words.format(names), f"palpate diagnose {results.folder}")
    if target == "image":
        return _command("Find out what the model lacks:", f"palpate diagnose {results.folder}")
    return Markup("The target was simulated: replace it with your own images.")


def _edge(results: StudyResults, name: str, estimate: ParameterEstimate) -> Markup:
    """Return a constant at a bound, with the values that its search may include on that side."""
    parameter = results.spec.case.parameters[name]
    value = estimate.estimate or 0.0
    lower = value - estimate.lower < estimate.upper - value
    text = parameter.side_text(lower=lower)
    named = _named(name, estimate)
    return Markup("{} (it must be {})").format(named, text) if text else named


def verdicts(known: Identification | None, names: Iterable[str]) -> dict[str, str]:
    """Return the verdict on each constant's identifiability; empty if unknown."""
    words = {
        "value": "",
        "limit": "",
        "weak": "weakly determined",
        "unknown": "no interval known",
        "ratio": "only its ratio",
    }
    constants = {} if known is None else known.constants
    return {n: words[constants[n].identifiable] if n in constants else "" for n in names}


def interval_text(constant: IdentifiedConstant | None) -> str:
    """Return the interval of a constant as "9.1 … 11", or a dash."""
    if constant is None or constant.interval is None:
        return "–"
    return f"{number(constant.interval.lower, 4)} … {number(constant.interval.upper, 4)}"


def about_intervals(known: Identification | None) -> str:
    """Return a sentence on the origin of the intervals; empty if there are none."""
    if known is None:
        return ""
    origins = {c.interval.origin: c.interval.level for c in known.constants.values() if c.interval}
    if not origins:
        return f"There are no intervals: {known.note}." if known.note else ""
    ((origin, level),) = list(origins.items())[:1]
    how = (
        "the derivatives of the best simulation"
        if origin == "tangents"
        else "the scatter of candidates as good as the best"
    )
    factor = (
        f" The residual is {number(known.noise_factor, 2)} times the stated noise, and the "
        "intervals are wider by that factor."
        if known.noise_factor > 1
        else ""
    )
    shares = [
        f"{name}: {in_words(c.errors, c.estimate)}"
        for name, c in known.constants.items()
        if c.errors
    ]
    if shares:
        factor += f" Standard deviations by source: {'; '.join(shares)}."
    return (
        f"Intervals are {100 * level:.0f} % intervals from {how}. A constant whose interval "
        f"is wider than half its value is weakly determined.{factor}"
    )


def _ratios(known: Identification, results: StudyResults) -> list[tuple[Markup, Quotability]]:
    """Return the ratios with their quotability, if only ratios can be found."""
    return [
        (
            Markup("{} / {} = {}").format(
                symbol(r.numerator), symbol(r.denominator), number(r.estimate, 3)
            ),
            ratio_quotability(results, r),
        )
        for r in known.ratios
    ]


def _named(name: str, estimate: ParameterEstimate) -> Markup:
    return symbol(name, estimate.unit)


def _command(words: str | Markup, command: str) -> Markup:
    return Markup("{} <code>{}</code>").format(words, command)

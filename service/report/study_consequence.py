"""Says what follows from a study: which constants can be quoted, and what to do next."""

from collections.abc import Iterable

from markupsafe import Markup

from service.formatting import at_edge, joined, number, symbol
from service.identification import Identification, IdentifiedConstant
from service.results import ParameterEstimate, StudyResults
from storage.task_records import TargetKind


def quotable(results: StudyResults) -> Markup:
    """Return a sentence on which constants may be quoted and which not; empty if there are none."""
    found = {n: e for n, e in results.estimates.items() if e.estimate is not None}
    if not found:
        return Markup("")
    if results.state != "stopped":
        return Markup("Quote nothing yet: the search goes on, and these are the best so far.")
    known = results.identification
    ratios = _ratios(known)
    if ratios:
        return ratios
    good: list[Markup] = []
    reasons: dict[str, list[Markup]] = {}
    for name, estimate in found.items():
        why = _against(estimate, None if known is None else known.constants.get(name))
        if why:
            reasons.setdefault(why, []).append(_named(name, estimate))
        else:
            good.append(_named(name, estimate))
    bad = [Markup("{} ({})").format(joined(names), why) for why, names in reasons.items()]
    if not bad:
        return Markup("Quote {}.").format(joined(good))
    if not good:
        return Markup("Do not quote {}.").format(joined(bad))
    return Markup("Quote {}; do not quote {}.").format(joined(good), joined(bad))


def next_step(results: StudyResults, target: TargetKind | None) -> Markup:
    """Return what to do next, with the command for it."""
    if results.state == "running":
        return Markup("This page is written again after every generation.")
    if results.state == "interrupted":
        return _command("Go on with the search:", f"palpate run {results.folder}")
    edges = [
        _named(n, e)
        for n, e in results.estimates.items()
        if e.estimate is not None and at_edge(e.estimate, (e.lower, e.upper))
    ]
    if edges:
        return Markup("Widen the searched interval of {} and run it under another name.").format(
            joined(edges)
        )
    known = results.identification
    if known is not None and _ratios(known):
        return Markup(
            "State the force of the plates, or hold one stiffness, to find values and not ratios."
        )
    weak = [] if known is None else [n for n in known.weak if n in results.estimates]
    if weak:
        names = joined([_named(n, results.estimates[n]) for n in weak])
        words = Markup("See what the model lacks, and whether anything would determine {} better:")
        return _command(words.format(names), f"palpate diagnose {results.folder}")
    if target == "image":
        return _command("See what the model lacks:", f"palpate diagnose {results.folder}")
    return Markup("The target was simulated: put images of your own in its place.")


def verdicts(known: Identification | None, names: Iterable[str]) -> dict[str, str]:
    """Return a word for how well each constant is determined; empty where it is not known."""
    words = {
        "value": "",
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
    """Return a sentence on what the intervals are; empty if there are none."""
    if known is None:
        return ""
    origins = {c.interval.origin: c.interval.level for c in known.constants.values() if c.interval}
    if not origins:
        return f"There are no intervals: {known.note}." if known.note else ""
    ((origin, level),) = list(origins.items())[:1]
    how = (
        "the derivatives of the best simulation"
        if origin == "tangents"
        else "the scatter of candidates that are as good as the best"
    )
    factor = (
        f" The model leaves {number(known.noise_factor, 2)} times the noise, and the intervals "
        "are widened by that."
        if known.noise_factor > 1
        else ""
    )
    return (
        f"Intervals hold with {100 * level:.0f} % and come from {how}. A constant whose interval "
        f"is wider than half its value is weakly determined.{factor}"
    )


def _against(estimate: ParameterEstimate, known: IdentifiedConstant | None) -> str:
    """Return why a constant is not to be quoted; empty if it may be."""
    value = estimate.estimate
    if value is not None and at_edge(value, (estimate.lower, estimate.upper)):
        return "it lies at the edge of the searched interval"
    if known is None or known.identifiable in ("value", "ratio"):
        return ""
    if known.interval is None:
        return "nothing says how well it is determined"
    return f"weakly determined, {interval_text(known)} {known.unit}".rstrip()


def _ratios(known: Identification | None) -> Markup:
    """Return a sentence where only ratios can be found; else nothing."""
    if known is None or not any(c.identifiable == "ratio" for c in known.constants.values()):
        return Markup("")
    ratios = [
        Markup("{} / {} = {}").format(
            symbol(r.numerator), symbol(r.denominator), number(r.estimate, 3)
        )
        for r in known.ratios
    ]
    told = Markup(": {}").format(joined(ratios)) if ratios else Markup("")
    return Markup(
        "Quote ratios only{}. The plates stand at a distance, so no force says how stiff the "
        "whole is, and no value in kPa can be found."
    ).format(told)


def _named(name: str, estimate: ParameterEstimate) -> Markup:
    return symbol(name, estimate.unit)


def _command(words: str | Markup, command: str) -> Markup:
    return Markup("{} <code>{}</code>").format(words, command)

"""Facts about the estimates of a study that decide whether they may be quoted."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from palpate.service.formatting import at_edge, listed
from palpate.service.results.identification import (
    DEPENDENT,
    WEAK_PART,
    IdentifiedConstant,
    IdentifiedRatio,
    Interval,
)
from palpate.service.results.quotable import (
    MOST_RESIDUAL,
    Bounds,
    EstimateFacts,
    Identifiable,
    Quotability,
    quotability,
)
from palpate.service.results.ratios import RatioEstimate
from palpate.storage.records.tasks import Scores

if TYPE_CHECKING:
    from palpate.service.results.record import ParameterEstimate, StudyResults

UNDEFORMED = "the undeformed body"


def study_quotability(results: "StudyResults") -> dict[str, Quotability]:
    """Return the quotability of each searched parameter, by internal name."""
    return {
        name: one.quotability or quotability(facts_of(results, name))
        for name, one in results.estimates.items()
    }


def facts_of(results: "StudyResults", name: str) -> EstimateFacts:
    """Return the facts about one searched parameter."""
    estimate, known = results.estimates[name], results.identification
    constant = None if known is None else known.constants.get(name)
    return EstimateFacts(
        value=estimate.estimate,
        unit=estimate.unit,
        searched=(estimate.lower, estimate.upper),
        interval=None if constant is None else ends(constant.interval),
        identifiable="unknown" if constant is None else constant.identifiable,
        finished=results.state == "stopped",
        converged=_converged(results),
        no_better_than=_no_better_than(results),
        residual_factor=1.0 if known is None else known.noise_factor,
        prior=_prior(results, name),
        prior_share=0.0 if constant is None else constant.prior_share,
        contradictions=(
            *_dependent(constant, results),
            *_of_all(results),
            *results.findings.get("against", {}).get(name, ()),
        ),
    )


def _prior(results: "StudyResults", name: str) -> Bounds | None:
    prior = results.spec.search.prior.get(results.estimates[name].gene)
    return None if prior is None else (prior.mean, prior.sd)


@dataclass(frozen=True)
class DerivedEstimate:
    """A value derived from the constants, with its 90 % interval.

    Parameters
    ----------
    name : str
    value : float
    unit : str
    interval : (float, float) or None
        None if it is withheld.
    answer : Quotability
    """

    name: str
    value: float
    unit: str
    interval: Bounds | None
    answer: Quotability


def derived_estimates(results: "StudyResults") -> list[DerivedEstimate]:
    """Return the values that an organ derives from the constants, such as G0 of a cornea."""
    return [_derived(results, one) for one in results.findings.get("derived", ())]


def with_intervals(results: "StudyResults") -> Mapping[str, Any]:
    """Return the findings with the intervals of derived values; None if withheld."""
    intervals = {one.name: one.interval for one in derived_estimates(results)}
    derived = results.findings.get("derived", ())
    found = [one | {"interval": intervals[one["name"]]} for one in derived]
    return {**results.findings, "derived": found} if found else results.findings


def _derived(results: "StudyResults", found: Mapping[str, Any]) -> DerivedEstimate:
    value, known = found["value"], results.identification
    factors = None if known is None else known.derived.get(found["name"])
    interval = None if factors is None else (value * factors.lower, value * factors.upper)
    answer = quotability(
        EstimateFacts(
            value=value,
            unit=found["unit"],
            interval=interval,
            identifiable=_how_known(value, interval),
            finished=results.state == "stopped",
            converged=_converged(results),
            no_better_than=_no_better_than(results),
            residual_factor=1.0 if known is None else known.noise_factor,
            contradictions=(*_bounded(results, found), *_of_all(results), *found["against"]),
        )
    )
    explained = known is not None and known.noise_factor <= MOST_RESIDUAL
    shown = interval if answer.interval_holds and explained else None
    return DerivedEstimate(found["name"], value, found["unit"], shown, answer)


def _bounded(results: "StudyResults", found: Mapping[str, Any]) -> list[str]:
    """Return a clause for each constant at a bound that affects a derived value."""
    estimates = results.estimates
    names = [
        n for n, by in found.get("slope", {}).items() if n in estimates and abs(by) > DEPENDENT
    ]
    return [
        f"it depends on {name}, which is at a bound of its searched interval"
        for name in names
        if (value := estimates[name].estimate) is not None
        and at_edge(value, (estimates[name].lower, estimates[name].upper))
    ]


def _how_known(value: float, interval: Bounds | None) -> Identifiable:
    if interval is None:
        return "unknown"
    return "weak" if interval[1] - interval[0] > WEAK_PART * abs(value) else "value"


def ratio_quotability(results: "StudyResults", ratio: IdentifiedRatio) -> Quotability:
    """Return the quotability of the ratio of two constants."""
    known = results.identification
    estimates = [results.estimates.get(n) for n in (ratio.numerator, ratio.denominator)]
    return quotability(
        EstimateFacts(
            value=ratio.estimate,
            interval=ends(ratio.interval),
            identifiable=ratio.identifiable,
            finished=results.state == "stopped",
            converged=_converged(results),
            no_better_than=_no_better_than(results),
            residual_factor=1.0 if known is None else known.noise_factor,
            contradictions=(*_at_bounds(estimates), *_of_all(results)),
        )
    )


def ratio_answer(
    results: "StudyResults", ratio: RatioEstimate
) -> tuple[tuple[float, float] | None, Quotability]:
    """Return the interval of a ratio, or None if withheld, and its quotability."""
    known = results.identification
    found = {(r.numerator, r.denominator): r for r in (known.ratios if known is not None else ())}
    identified = found.get((ratio.numerator, ratio.denominator))
    if identified is None:
        identified = IdentifiedRatio(
            ratio.numerator, ratio.denominator, ratio.estimate or float("nan"), None, "unknown"
        )
    answer = ratio_quotability(results, identified)
    return (ends(identified.interval) if answer.interval_holds else None), answer


def ends(interval: Interval | None) -> tuple[float, float] | None:
    """Return the ends of an interval."""
    return None if interval is None else (interval.lower, interval.upper)


def no_better(
    before: Mapping[str, Scores], after: Mapping[str, Scores], parts: Iterable[str]
) -> bool:
    """Return True if the best candidate matches the target no better than the undeformed body."""
    compared = [part for part in parts if part in before and part in after]
    if not compared:
        return False
    return sum(after[p]["gsf"] for p in compared) >= sum(before[p]["gsf"] for p in compared)


def _no_better_than(results: "StudyResults") -> str:
    parts = results.spec.score.parts
    worse = no_better(results.undeformed_scores, results.best_scores, parts)
    return UNDEFORMED if worse else ""


def _converged(results: "StudyResults") -> bool:
    known = results.identification
    stopped_early = "has not converged" in (results.stop_reason or "")
    return not stopped_early and (known is None or known.converged)


def _dependent(constant: IdentifiedConstant | None, results: "StudyResults") -> list[str]:
    names = () if constant is None else constant.depends_on
    return [f"it depends on {name}, which is at a bound of its searched interval" for name in names]


def _at_bounds(estimates: Iterable["ParameterEstimate | None"]) -> list[str]:
    found = []
    for one in estimates:
        if one is not None:
            facts = EstimateFacts(
                value=one.estimate, unit=one.unit, searched=(one.lower, one.upper)
            )
            found += [
                f"{one.gene} is {reason}"
                for reason in quotability(facts).reasons
                if "bound" in reason
            ]
    return found


def _of_all(results: "StudyResults") -> tuple[str, ...]:
    """Return the objections to every estimate, as clauses."""
    return (*_supported(results), *([results.squeezed] if results.squeezed else []))


def _supported(results: "StudyResults") -> list[str]:
    known = results.identification
    if known is None or not known.supported:
        return []
    first, *others = known.supported
    beside = f", or in {listed(others, 'or')}" if others else ""
    return [f"the residual points to an error in {first}{beside}"]

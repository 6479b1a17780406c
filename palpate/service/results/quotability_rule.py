"""The rule that decides whether an estimate may be quoted, with its reasons.

Every estimate that Palpate reports, from a study, a diagnosis, a bench experiment or a cornea, is
described by an `EstimateFacts` and judged by `quotability`. Terminal, page, JSON, Python and
service show its answer in the same words.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeVar

from palpate.service.number_formatting import listed, number
from palpate.service.results.physical_limits import Bounds, at_bound

N = TypeVar("N", bound=str)
IdentifiedAs = Literal["value", "limit", "ratio", "weak", "unknown"]

# A residual of more than this multiple of the stated noise means that the model is wrong, which
# no interval can make up for. Calibrated by tests/benchmarks/interval_coverage.py.
MOST_RESIDUAL = 2.0
# Above this share of the information, a constant's prior counts for more than the images.
MOST_OF_PRIOR = 0.5
# A value this many standard deviations from the mean of its prior contradicts it.
MOST_DEVIATIONS = 3.0
UNFINISHED = "the search has not finished, and this is the best value so far"


@dataclass(frozen=True, kw_only=True)
class EstimateFacts:
    """The facts that decide whether an estimate may be quoted.

    All values are in the user's unit. Facts that do not apply keep their defaults.

    Parameters
    ----------
    value : float or None
        None if nothing was estimated.
    unit : str
        Such as kPa; empty for a pure number.
    searched : (float, float) or None
        Bounds of the search.
    limit : float or None
        Physical limit, below which there are no values; a search may end there.
    stated : (float, float) or None
        Interval given for the constant in the user's file, if it does not bound the search.
    interval : (float, float) or None
        90 % interval.
    identifiable : {"value", "limit", "ratio", "weak", "unknown"}
        ``limit``: it rests at `limit`, and the interval is one-sided. ``ratio``: only its ratio
        to other constants. ``weak``: the interval is wider than half the value. ``unknown``:
        nothing is known about its precision.
    finished : bool
        Whether the search has stopped.
    converged : bool
        Whether the search has reached its optimum.
    no_better_than : str
        A body that explains the image as well as the best fit, such as ``the undeformed
        body``; empty if the best fit is better.
    residual_factor : float
        Ratio of the best fit's residual to the stated noise.
    prior : (float, float) or None
        Mean and standard deviation of the prior.
    prior_share : float
        Part of the information on the value that its prior contributes, 0 to 1.
    contradictions : tuple of str
        Other statements in the same results that contradict the estimate, as clauses.
    """

    value: float | None
    unit: str = ""
    searched: Bounds | None = None
    limit: float | None = None
    stated: Bounds | None = None
    interval: Bounds | None = None
    identifiable: IdentifiedAs = "value"
    finished: bool = True
    converged: bool = True
    no_better_than: str = ""
    residual_factor: float = 1.0
    prior: Bounds | None = None
    prior_share: float = 0.0
    contradictions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Quotability:
    """The quotability of an estimate.

    Parameters
    ----------
    quotable : bool
    reasons : tuple of str
        Why not, as clauses; empty if and only if quotable.
    estimated : bool
        False if there is no estimate: the value and its interval are not shown.
    interval_holds : bool
        False if the interval is withheld because it does not describe the optimum.
    """

    quotable: bool
    reasons: tuple[str, ...]
    estimated: bool = True
    interval_holds: bool = True

    @property
    def sentence(self) -> str:
        """Return "Quotable" or "Not quotable: ...", without a full stop."""
        return "Quotable" if self.quotable else f"Not quotable: {'; '.join(self.reasons)}"

    def as_dict(self) -> dict[str, Any]:
        """Return the keys ``quotable`` and ``reasons`` of a JSON record."""
        record = asdict(self)
        return {"quotable": record["quotable"], "reasons": list(self.reasons)}


def quotability(facts: EstimateFacts) -> Quotability:
    """Decide whether an estimate may be quoted.

    Examples
    --------
    >>> facts = EstimateFacts(value=20.0, unit="kPa", searched=(2.0, 20.0), interval=(19, 20))
    >>> quotability(facts).reasons
    ('at the upper bound of the searched interval (20 kPa)',)
    >>> limit = {"limit": 0.0, "identifiable": "limit", "interval": (0, 12)}
    >>> quotability(EstimateFacts(value=0.0, unit="kPa", searched=(0.0, 100.0), **limit)).quotable
    True
    """
    if facts.value is None or not math.isfinite(facts.value):
        return Quotability(False, ("nothing was estimated",), False, False)
    if not facts.finished:
        return Quotability(False, (UNFINISHED,), True, False)
    reasons = [
        *_unconverged(facts),
        *_bounds(facts, facts.value),
        *_interval(facts),
        *_misfit(facts),
        *_prior(facts, facts.value),
        *facts.contradictions,
    ]
    estimated = not facts.no_better_than
    holds = facts.converged and estimated
    return Quotability(not reasons, tuple(dict.fromkeys(reasons)), estimated, holds)


# A reason that ends in a value or an interval: "weakly determined, 5 to 15 kPa".
_ENDING = re.compile(r"(\D+?),? \(?([−\d][^\s()]*(?: to [−\d]\S*)?(?: [^\s\d()]+)?)\)?")


def names_by_reason(answers: Mapping[N, Quotability]) -> list[tuple[list[tuple[N, str]], str]]:
    """Group names by reason, the reason that concerns most names first.

    Reasons that differ only in the value or interval at their end are one. Every name has that
    ending beside it; it is empty for the other reasons.

    Examples
    --------
    >>> weak = [Quotability(False, (f"weakly determined, {i} kPa",)) for i in ("2 to 5", "1 to 9")]
    >>> names_by_reason({"E": weak[0], "eta": weak[1]})
    [([('E', '2 to 5 kPa'), ('eta', '1 to 9 kPa')], 'weakly determined')]
    """
    whole: dict[str, list[N]] = {}
    for name, answer in answers.items():
        for reason in answer.reasons:
            whole.setdefault(reason, []).append(name)
    heads: dict[str, list[str]] = {}
    for reason in whole:
        match = _ENDING.fullmatch(reason)
        heads.setdefault(match[1] if match else reason, []).append(reason)
    groups: list[tuple[list[tuple[N, str]], str]] = []
    for head, reasons in heads.items():
        if len(reasons) == 1:
            groups.append(([(name, "") for name in whole[reasons[0]]], reasons[0]))
            continue
        endings = [(reason, match[2]) for reason in reasons if (match := _ENDING.fullmatch(reason))]
        groups.append(([(name, end) for reason, end in endings for name in whole[reason]], head))
    return sorted(groups, key=lambda group: -len(group[0]))


def repeated(groups: Sequence[tuple[list[tuple[N, str]], str]]) -> list[bool]:
    """Return for each group of `names_by_reason` whether all its names stand in earlier ones."""
    named: set[N] = set()
    repeats = []
    for names, _ in groups:
        own = {name for name, _ in names}
        repeats.append(own <= named)
        named |= own
    return repeats


def reason_lines(answers: Mapping[str, Quotability]) -> list[str]:
    """Return a sentence for each reason, with the names that may not be quoted for it.

    Examples
    --------
    >>> reason_lines({name: Quotability(False, (UNFINISHED,)) for name in ("E", "eta")})[0][:27]
    'Not quotable: E and eta: th'
    """
    groups = names_by_reason(answers)
    starts = ("Of these," if repeats else "Not quotable:" for repeats in repeated(groups))
    return [
        f"{start} {listed([f'{n} ({end})' if end else n for n, end in names])}: {reason}."
        for start, (names, reason) in zip(starts, groups, strict=True)
    ]


def _unconverged(facts: EstimateFacts) -> list[str]:
    return [] if facts.converged else ["the search has not converged"]


def _bounds(facts: EstimateFacts, value: float) -> list[str]:
    """Return objections to the value's position in the searched and the given interval."""
    reasons = []
    if facts.searched is not None and at_bound(value, facts.searched, facts.limit):
        low, high = facts.searched
        side, bound = ("lower", low) if value - low < high - value else ("upper", high)
        where = f"bound of the searched interval ({_with_unit(bound, facts.unit)})"
        beyond = value < low or value > high
        reasons.append(f"{'beyond' if beyond else 'at'} the {side} {where}")
    if facts.stated is not None and not facts.stated[0] <= value <= facts.stated[1]:
        reasons.append(f"outside its stated interval ({_between(facts.stated, facts.unit)})")
    return reasons


def _interval(facts: EstimateFacts) -> list[str]:
    if facts.identifiable == "ratio":
        return ["only its ratio to the other stiffnesses can be found"]
    if facts.identifiable == "weak" and facts.interval is not None and facts.converged:
        return [f"weakly determined, {_between(facts.interval, facts.unit)}"]
    if facts.identifiable == "weak":
        return ["weakly determined"]
    if facts.identifiable == "unknown" or facts.interval is None:
        return ["no interval is known"]
    return []


def _misfit(facts: EstimateFacts) -> list[str]:
    reasons = []
    if facts.no_better_than:
        reasons.append(f"the best fit is no better than {facts.no_better_than}")
    if facts.residual_factor > MOST_RESIDUAL:
        reasons.append(
            f"the residual is {number(facts.residual_factor, 2)} times the stated noise "
            f"(at most {number(MOST_RESIDUAL, 2)} times)"
        )
    return reasons


def _prior(facts: EstimateFacts, value: float) -> list[str]:
    if facts.prior is None:
        return []
    mean, sd = facts.prior
    if abs(value - mean) > MOST_DEVIATIONS * sd:
        far = number(abs(value - mean) / sd, 2)
        return [f"{far} standard deviations from the mean of its prior, against the images"]
    if facts.prior_share > MOST_OF_PRIOR:
        return ["the prior determines it more than the images do"]
    return []


def _between(ends: Bounds, unit: str) -> str:
    return f"{number(ends[0], 4)} to {_with_unit(ends[1], unit)}"


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value, 4)} {unit}".rstrip()

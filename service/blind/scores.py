"""The figures of a set, each beside its target.

A true gap counts as visible above 1.5 times the floor: what the calibrated model still
misses, without noise, in the median control. Cases below it are shown, and judged apart.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import median as middle
from typing import Literal

import numpy as np

from service.blind.probability import brier, brier_of_base_rates
from service.blind.records import CaseRecord
from service.blind.statistics import Estimate, correlation, mean, median, share
from workers.diagnosis.verdict import NONE_OF_THESE
from workers.effects.inclusion import INCLUSION

Unit = Literal["share", "mm", "number"]
VISIBLE = 1.5
CLEAR = 3.0
# A gap may be wrong by so much, or by this part of it.
GAP_MM, GAP_PART = 0.05, 0.25


@dataclass(frozen=True)
class Target:
    """What a figure should reach."""

    value: float
    at_least: bool

    def met(self, value: float) -> bool:
        """Whether a value does."""
        return value >= self.value if self.at_least else value <= self.value


@dataclass(frozen=True)
class Figure:
    """One figure.

    Parameters
    ----------
    key, title : str
    estimate : Estimate
    unit : {"share", "mm", "number"}
    target : Target or None
        None where the figure only informs.
    met : bool or None
        None without a target or without a case.
    """

    key: str
    title: str
    estimate: Estimate
    unit: Unit
    target: Target | None
    met: bool | None


Records = Sequence[CaseRecord]


def floor_mm(records: Records) -> float | None:
    """True gap of the median control; None without controls."""
    gaps = [r.true_before_mm for r in records if r.group == "control"]
    known = [g for g in gaps if g is not None]
    return middle(known) if known else None


def visible(record: CaseRecord, floor: float | None) -> bool:
    """Whether the true gap stands out of the floor; True where nobody can tell."""
    if floor is None or record.true_before_mm is None:
        return True
    return record.true_before_mm > VISIBLE * floor


def regrouped(records: Records) -> list[CaseRecord]:
    """What should hide in the constants but stands out of the floor is an effect to be named.

    A wrong force scales all moduli alike and leaves no gap; where anything else in the model
    has a stiffness of its own, it leaves one.
    """
    floor = floor_mm(records)

    def stands_out(r: CaseRecord) -> bool:
        known = floor is not None and r.true_before_mm is not None
        return known and r.group == "absorbed" and visible(r, floor)

    return [replace(r, group="single") if stands_out(r) else r for r in records]


def figures(records: Records) -> list[Figure]:
    """All figures.

    Parameters
    ----------
    records : sequence of CaseRecord
        As `regrouped` leaves them.
    """
    floor = floor_mm(records)
    return [
        *_alarms(records, floor),
        *_singles(records, floor),
        *_others(records, floor),
        *_gaps(records),
        *_sizes(records),
        *_probabilities(records),
        *_baselines(records, floor),
    ]


def _alarms(records: Records, floor: float | None) -> Iterable[Figure]:
    silent = [r for r in records if r.silent]
    named = [r for r in records if r.named]
    unsure = [r for r in records if r.answer == "cannot-be-told-apart"]
    alarms = share([r.answer != "no-gap" for r in silent])
    yield _figure(
        "false_alarms", "False alarms on controls and hidden effects", alarms, at_most=0.05
    )
    right = share([r.right_first for r in named])
    yield _figure("named_right", "An effect that is named acts", right, at_least=0.95)
    known = [r for r in named if r.group in ("control", "absorbed", "single", "pair")]
    strict = share([r.strictly_right for r in known])
    yield _figure("strict", "Nothing superfluous is named", strict, at_least=0.80)
    first = share([r.right_first for r in unsure])
    yield _figure("unsure_right", "The first of those that cannot be told apart acts", first)


def _singles(records: Records, floor: float | None) -> Iterable[Figure]:
    singles = [r for r in records if r.group == "single"]
    seen = [r for r in singles if visible(r, floor)]
    yield _figure(
        "first_visible", "One effect, visible: it comes first", _right_first(seen), at_least=0.90
    )
    for key, title, chosen in strata(singles, floor):
        yield _figure(f"first_{key}", f"One effect, {title}: it comes first", _right_first(chosen))
    covered = share([r.covered for r in singles])
    yield _figure("covered", "One effect: it is in the 90 % set", covered, at_least=0.90)
    covered = share([r.covered for r in seen])
    yield _figure("covered_visible", "One effect, visible: it is in the 90 % set", covered)


def strata(records: Records, floor: float | None) -> list[tuple[str, str, list[CaseRecord]]]:
    """Cases by their true gap in units of the floor; none where there is no floor."""
    if floor is None:
        return []
    known = [(r, r.true_before_mm / floor) for r in records if r.true_before_mm is not None]
    return [
        ("faint", f"gap up to {VISIBLE:g} floors", [r for r, g in known if g <= VISIBLE]),
        ("middling", f"gap of {VISIBLE:g} to {CLEAR:g} floors",
         [r for r, g in known if VISIBLE < g <= CLEAR]),
        ("clear", f"gap above {CLEAR:g} floors", [r for r, g in known if g > CLEAR]),
    ]  # fmt: skip


def _others(records: Records, floor: float | None) -> Iterable[Figure]:
    def of(group: str, seen: bool) -> list[CaseRecord]:
        own = [r for r in records if r.group == group]
        return [r for r in own if visible(r, floor)] if seen else own

    def none(chosen: list[CaseRecord]) -> Estimate:
        return share([r.answer == NONE_OF_THESE for r in chosen])

    unlike = "Unlike any effect"
    yield _figure("unlike_visible", f"{unlike}, visible: none of these", none(of("unlike", True)),
                  at_least=0.80)  # fmt: skip
    yield _figure("unlike", f"{unlike}, all: none of these", none(of("unlike", False)))
    family = share([r.right_family for r in of("relative", True)])
    yield _figure("relatives", "Relative of an effect, visible: its family is named", family,
                  at_least=0.80)  # fmt: skip
    pairs = of("pair", True)
    dominant = share([r.first in r.effects for r in pairs])
    yield _figure("pairs_first", "Two effects, visible: one of them comes first", dominant,
                  at_least=0.90)  # fmt: skip
    both = share([set(r.primary) == set(r.effects) for r in pairs])
    yield _figure("pairs_both", "Two effects, visible: both are named", both, at_least=0.40)


def _gaps(records: Records) -> Iterable[Figure]:
    before = _both(records, lambda r: r.claimed_before_mm, lambda r: r.true_before_mm)
    off = mean([abs(c - t) for c, t in before])
    part = mean([abs(c - t) / t for c, t in before if t > 0])
    met = None if off.value is None else off.value <= GAP_MM or (part.value or 1.0) <= GAP_PART
    yield Figure("gap_error", "Error of the gap before, or at most 25 % of it", off, "mm",
                 Target(GAP_MM, False), met)  # fmt: skip
    yield _figure("gap_error_part", "The same as a part of the gap", part)
    held = _within(records, lambda r: r.gap_interval_mm, lambda r: r.true_before_mm)
    yield _figure("gap_within", "True gap before within its interval of 90 %", held)
    after = _both(records, lambda r: r.claimed_after_mm, lambda r: r.true_after_mm)
    yield _figure("gap_after_error", "Error of the gap that is left",
                  mean([abs(c - t) for c, t in after]), "mm")  # fmt: skip
    held = _within(records, lambda r: r.share_interval, lambda r: r.true_share)
    yield _figure("shrinkage_within", "True shrinkage within its interval of 90 %", held)
    shares: tuple[tuple[str, str, Callable[[CaseRecord], float | None]], ...] = (
        ("held_out", "on unseen scans", lambda r: r.held_out_share),
        ("in_sample", "on the scans fitted", lambda r: r.claimed_share),
    )
    for key, where, claimed in shares:
        pairs = _both(records, claimed, lambda r: r.true_share)
        off = mean([abs(c - t) for c, t in pairs])
        along = correlation([c for c, _ in pairs], [t for _, t in pairs])
        limit = {"at_most": 0.12} if key == "held_out" else {}
        least = {"at_least": 0.85} if key == "held_out" else {}
        yield _figure(f"shrinkage_error_{key}", f"Error of the shrinkage claimed {where}", off,
                      "number", **limit)  # fmt: skip
        yield _figure(f"shrinkage_correlation_{key}",
                      f"Correlation of the shrinkage claimed {where} with the true one", along,
                      "number", **least)  # fmt: skip


def _sizes(records: Records) -> Iterable[Figure]:
    lumps = [(r.lump_apart_mm, INCLUSION.name in r.primary) for r in records]
    named = [mm for mm, accused in lumps if accused and mm is not None]
    other = [mm for mm, accused in lumps if not accused and mm is not None]
    yield _figure("lump", "A lump is named: its found centre to the true one", mean(named), "mm",
                  at_most=3.0)  # fmt: skip
    yield _figure("lump_unnamed", "A lump is not named: its likeliest centre to the true one",
                  mean(other), "mm")  # fmt: skip
    sizes = [m for r in records if r.right_first for m in r.magnitudes]
    off = [abs(m.found - m.true) / m.sd for m in sizes if m.sd > 0]
    yield _figure("magnitude_sds", "Error of a magnitude in its standard deviations", median(off),
                  "number")  # fmt: skip
    yield _figure("magnitude_within", "Magnitudes within two standard deviations",
                  share([x <= 2 for x in off]))  # fmt: skip
    part = [abs(m.found / m.true - 1) for m in sizes if m.true]
    yield _figure("magnitude_part", "Error of a magnitude as a part of it", median(part))


def _probabilities(records: Records) -> Iterable[Figure]:
    score, naive = brier(records), brier_of_base_rates(records)
    yield _figure("brier", "Brier score of all statements", score, "number")
    yield _figure("brier_naive", "Brier score of the frequencies of the causes", naive, "number")


def _baselines(records: Records, floor: float | None) -> Iterable[Figure]:
    """How the baselines do on the cases of `first_visible`."""
    seen = [r for r in records if r.group == "single" and visible(r, floor)]
    titles = {"raw_correlation": "largest raw correlation", "refit": "one refit at a time"}
    for key, title in titles.items():
        right = share([r.accused_by.get(key) in r.effects for r in seen])
        yield _figure(f"baseline_{key}", f"Baseline, {title}: it comes first", right)
    chance = [1 / r.catalogue for r in seen if r.catalogue]
    value = float(np.mean(chance)) if chance else None
    yield _figure("baseline_chance", "Baseline, chance: it comes first",
                  Estimate(value, value, value, len(chance)))  # fmt: skip


def _right_first(records: Records) -> Estimate:
    return share([r.right_first for r in records])


def _both(
    records: Records,
    claimed: Callable[[CaseRecord], float | None],
    true: Callable[[CaseRecord], float | None],
) -> list[tuple[float, float]]:
    """Claimed and true, where both are known."""
    pairs = [(claimed(r), true(r)) for r in records]
    return [(c, t) for c, t in pairs if c is not None and t is not None]


def _within(
    records: Records,
    interval: Callable[[CaseRecord], tuple[float, float] | None],
    true: Callable[[CaseRecord], float | None],
) -> Estimate:
    """How often the truth lies in the interval, where both are known."""
    both = [(interval(r), true(r)) for r in records]
    return share([i[0] <= t <= i[1] for i, t in both if i is not None and t is not None])


def _figure(
    key: str, title: str, estimate: Estimate, unit: Unit = "share",
    at_least: float | None = None, at_most: float | None = None,
) -> Figure:  # fmt: skip
    target = None
    if at_least is not None:
        target = Target(at_least, True)
    elif at_most is not None:
        target = Target(at_most, False)
    known = target is not None and estimate.value is not None
    met = target.met(estimate.value) if known and target and estimate.value is not None else None
    return Figure(key, title, estimate, unit, target, met)

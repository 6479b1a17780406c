"""Metrics of a set and their targets.

A true gap counts as visible above 1.5 times the floor, the noise-free gap of the calibrated model
in the median control. Cases below that limit are listed but judged separately.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import median as middle
from typing import Literal

import numpy as np

from palpate.service.blind.answer_statistics import (
    SURE,
    Estimate,
    brier,
    brier_of_base_rates,
    calibration_error,
    correlation,
    log_score,
    mean,
    median,
    share,
    sure_statements,
)
from palpate.service.blind.case_truth import MAPPED, CaseRecord
from palpate.service.blind.set_answering import baseline_threshold
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

Unit = Literal["share", "mm", "number"]
VISIBLE = 1.5
CLEAR = 3.0
# Standard deviations: 8 nats, about 5 for the search over two dozen effects of any size, and
# 3 for odds of twenty to one.
STRONG = 4.0
# Tolerances of a gap: absolute, and relative.
GAP_MM, GAP_PART = 0.05, 0.25


@dataclass(frozen=True)
class Target:
    """A bound for a metric."""

    value: float
    at_least: bool

    def met(self, value: float) -> bool:
        """Return True if a value satisfies the bound."""
        return value >= self.value if self.at_least else value <= self.value


@dataclass(frozen=True)
class Metric:
    """One measure of the quality of a diagnosis.

    Parameters
    ----------
    key, title : str
    estimate : Estimate
    unit : {"share", "mm", "number"}
    target : Target or None
        None if the metric is only informative.
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
    """Return the true gap of the median control in mm; None without controls."""
    gaps = [r.true_before_mm for r in records if r.group == "control"]
    known = [g for g in gaps if g is not None]
    return middle(known) if known else None


def visible(record: CaseRecord, floor: float | None) -> bool:
    """Return True if the true gap exceeds the visible limit, or if this is unknown."""
    if floor is None or record.true_before_mm is None:
        return True
    return record.true_before_mm > VISIBLE * floor


def regrouped(records: Records) -> list[CaseRecord]:
    """Return records in which hidden effects with a visible gap count as single effects.

    A wrong force scales all moduli alike and leaves no gap, unless another part of the model
    has a separate stiffness.
    """
    floor = floor_mm(records)

    def stands_out(r: CaseRecord) -> bool:
        known = floor is not None and r.true_before_mm is not None
        return known and r.group == "absorbed" and visible(r, floor)

    return [replace(r, group="single") if stands_out(r) else r for r in records]


def metrics(records: Records) -> list[Metric]:
    """Return all metrics.

    Parameters
    ----------
    records : sequence of CaseRecord
        As returned by `regrouped`.
    """
    floor = floor_mm(records)
    return [
        *_alarms(records),
        *_singles(records, floor),
        *_others(records, floor),
        *_gaps(records),
        *_shrinkages(records),
        *_sizes(records),
        *_probabilities(records),
        *_baselines(records, floor),
    ]


def _alarms(records: Records) -> Iterable[Metric]:
    silent = [r for r in records if r.silent]
    alarms = share([r.answer != "no-gap" for r in silent])
    yield _metric(
        "false_alarms", "False alarms on controls and hidden effects", alarms, _at_most(0.05)
    )
    sure = share([r.named or r.probabilities.get(NONE_OF_THESE, 0.0) >= SURE for r in silent])
    yield _metric(
        "sure_alarms", f"False alarms with a probability of {100 * SURE:.0f} % or more", sure
    )
    named = [r for r in records if r.named]
    acts = share([r.right_first for r in named])
    yield _metric("named_right", "A named effect acts", acts, _at_least(0.95))
    known = [r for r in named if r.group not in ("unlike", "relative")]
    strict = share([r.strictly_right for r in known])
    yield _metric("strict", "No superfluous effect is named", strict, _at_least(0.80))
    unsure = [r for r in records if r.answer == "cannot-be-told-apart"]
    first = share([r.right_first for r in unsure])
    yield _metric("unsure_right", "The first of several indistinguishable effects acts", first)


def _singles(records: Records, floor: float | None) -> Iterable[Metric]:
    singles = [r for r in records if r.group == "single"]
    in_sight = [r for r in singles if visible(r, floor)]
    title = "One effect, visible: ranked first"
    yield _metric("first_visible", title, _right_first(in_sight), _at_least(0.90))
    for key, stratum, chosen in strata(singles, floor):
        title = f"One effect, {stratum}: ranked first"
        yield _metric(f"first_{key}", title, _right_first(chosen))
    for key, stratum, chosen in by_strength(singles):
        title = f"One effect, {stratum}: ranked first"
        yield _metric(f"first_{key}", title, _right_first(chosen))
    covered = share([r.covered for r in singles])
    yield _metric("covered", "One effect: in the 90 % set", covered, _at_least(0.90))
    covered = share([r.covered for r in in_sight])
    yield _metric("covered_visible", "One effect, visible: in the 90 % set", covered)


def strata(records: Records, floor: float | None) -> list[tuple[str, str, list[CaseRecord]]]:
    """Return cases grouped by their true gap in units of the floor; none without a floor."""
    if floor is None:
        return []
    known = [(r, r.true_before_mm / floor) for r in records if r.true_before_mm is not None]
    faint = [r for r, g in known if g <= VISIBLE]
    middling = [r for r, g in known if VISIBLE < g <= CLEAR]
    clear = [r for r, g in known if g > CLEAR]
    return [
        ("faint", f"gap up to {VISIBLE:g} floors", faint),
        ("middling", f"gap of {VISIBLE:g} to {CLEAR:g} floors", middling),
        ("clear", f"gap above {CLEAR:g} floors", clear),
    ]


def by_strength(records: Records) -> list[tuple[str, str, list[CaseRecord]]]:
    """Return cases grouped by the size of their effect in standard deviations."""
    known = [(r, r.strength) for r in records if r.strength is not None]
    weak = [r for r, s in known if s < STRONG]
    strong = [r for r, s in known if s >= STRONG]
    deviations = f"{STRONG:g} standard deviations of its estimate"
    return [("weak", f"below {deviations}", weak), ("strong", f"of {deviations} or more", strong)]


def _others(records: Records, floor: float | None) -> Iterable[Metric]:
    in_sight = [r for r in records if visible(r, floor)]
    unlike = _none_of_these([r for r in in_sight if r.group == "unlike"])
    title = "Unlike any effect, visible: answered none of these"
    yield _metric("unlike_visible", title, unlike, _at_least(0.80))
    careful = share([r.is_careful for r in in_sight if r.group == "unlike"])
    title = "Unlike any effect, visible: answered none of these, or uncertain"
    yield _metric("unlike_careful", title, careful, _at_least(0.85))
    unlike = _none_of_these([r for r in records if r.group == "unlike"])
    yield _metric("unlike", "Unlike any effect, all: answered none of these", unlike)
    family = share([r.right_family for r in in_sight if r.group == "relative"])
    title = "Relative of an effect, visible: family is named"
    yield _metric("relatives", title, family, _at_least(0.80))
    pairs = [r for r in in_sight if r.group == "pair"]
    dominant = share([r.first in r.effects for r in pairs])
    title = "Two effects, visible: one of them is ranked first"
    yield _metric("pairs_first", title, dominant, _at_least(0.90))
    both = share([set(r.primary) == set(r.effects) for r in pairs])
    yield _metric("pairs_both", "Two effects, visible: both are named", both, _at_least(0.40))
    triples = [r for r in in_sight if r.group == "triple"]
    first = share([r.first in r.effects for r in triples])
    yield _metric("triples_first", "Three effects, visible: one of them is ranked first", first)
    two = share([len(set(r.primary) & set(r.effects)) >= 2 for r in triples])
    title = "Three effects, visible: two of them are named"
    yield _metric("triples_two", title, two, _at_least(0.50))


def _gaps(records: Records) -> Iterable[Metric]:
    before = _both(records, lambda r: r.claimed_before_mm, lambda r: r.true_before_mm)
    error = mean([abs(c - t) for c, t in before])
    part = mean([abs(c - t) / t for c, t in before if t > 0])
    met = None if error.value is None else error.value <= GAP_MM or (part.value or 1.0) <= GAP_PART
    title = "Error of the nominal gap, or at most 25 % of it"
    yield Metric("gap_error", title, error, "mm", _at_most(GAP_MM), met)
    yield _metric("gap_error_part", "Relative error of the nominal gap", part)
    slid = _both(records, lambda r: r.claimed_before_mm, lambda r: r.true_material_mm)
    error = mean([abs(c - t) for c, t in slid])
    title = "Error of the nominal gap, measured at material points"
    yield _metric("gap_error_material", title, error, unit="mm")
    within = _within(records, lambda r: r.gap_interval_mm, lambda r: r.true_before_mm)
    yield _metric("gap_within", "True nominal gap within its 90 % interval", within)
    after = _both(records, lambda r: r.claimed_after_mm, lambda r: r.true_after_mm)
    error = mean([abs(c - t) for c, t in after])
    yield _metric("gap_after_error", "Error of the gap with the named effects", error, unit="mm")


def _shrinkages(records: Records) -> Iterable[Metric]:
    within = _within(records, lambda r: r.share_interval, lambda r: r.true_share)
    yield _metric("shrinkage_within", "True shrinkage within its 90 % interval", within)
    targets = _at_most(0.12), _at_least(0.85)
    claims = (
        ("claimed", "", lambda r: r.claimed_share),
        ("held_out", " on unseen scans", lambda r: r.held_out_share),
    )
    for key, where, claimed in claims:
        yield from _shrinkage(records, key, where, claimed, targets)


def _shrinkage(
    records: Records,
    key: str,
    where: str,
    claimed: Callable[[CaseRecord], float | None],
    targets: tuple[Target, Target],
) -> Iterable[Metric]:
    """Yield the error and the correlation of the claimed shrinkage, with their targets."""
    pairs = _both(records, claimed, lambda r: r.true_share)
    error = mean([abs(c - t) for c, t in pairs])
    title = f"Error of the claimed shrinkage{where}"
    yield _metric(f"shrinkage_error_{key}", title, error, targets[0], "number")
    along = correlation([c for c, _ in pairs], [t for _, t in pairs])
    title = f"Correlation of claimed and true shrinkage{where}"
    yield _metric(f"shrinkage_correlation_{key}", title, along, targets[1], "number")


def _sizes(records: Records) -> Iterable[Metric]:
    lumps = [(r.lump_apart_mm, MAPPED.name in r.primary) for r in records]
    named = mean([mm for mm, is_named in lumps if is_named and mm is not None])
    unnamed = mean([mm for mm, is_named in lumps if not is_named and mm is not None])
    title = "Lump is named: distance from its centre to the true one"
    yield _metric("lump", title, named, _at_most(3.0), "mm")
    title = "Lump is not named: distance from its most probable centre to the true one"
    yield _metric("lump_unnamed", title, unnamed, unit="mm")
    sizes = [m for r in records if r.right_first for m in r.magnitudes]
    errors = [abs(m.found - m.true) / m.sd for m in sizes if m.sd > 0]
    title = "Error of a magnitude in standard deviations"
    yield _metric("magnitude_sds", title, median(errors), unit="number")
    within = share([error <= 2 for error in errors])
    yield _metric("magnitude_within", "Magnitudes within two standard deviations", within)
    part = [abs(m.found / m.true - 1) for m in sizes if m.true]
    yield _metric("magnitude_part", "Relative error of a magnitude", median(part))


def _probabilities(records: Records) -> Iterable[Metric]:
    score, naive = brier(records), brier_of_base_rates(records)
    sure = sure_statements(records)
    title = "Statements of 90 % or more that are true"
    yield _metric("sure_statements", title, sure, _at_least(0.93))
    error = calibration_error(records)
    title = "Expected calibration error of all statements"
    yield _metric("calibration_error", title, error, _at_most(0.06), unit="number")
    yield _metric("log_score", "Log score of all statements", log_score(records), unit="number")
    yield _metric("brier", "Brier score of all statements", score, unit="number")
    title = "Brier score of the base rates"
    yield _metric("brier_naive", title, naive, unit="number")


def _baselines(records: Records, floor: float | None) -> Iterable[Metric]:
    """Score the baselines on the cases of `first_visible`."""
    in_sight = [r for r in records if r.group == "single" and visible(r, floor)]
    titles = {"raw_correlation": "largest raw correlation", "refit": "one refit at a time"}
    for key, title in titles.items():
        right = share([r.named_by.get(key) in r.effects for r in in_sight])
        yield _metric(f"baseline_{key}", f"Baseline, {title}: ranked first", right)
        least = _threshold(records, key)
        if least is not None:
            spoken = [
                r.named_by.get(key) in r.effects and r.loudness.get(key, 0.0) > least
                for r in in_sight
            ]
            also = f"Baseline, {title}, with as few false alarms: ranked first"
            yield _metric(f"baseline_{key}_silent", also, share(spoken))
    chance = [1 / r.catalogue for r in in_sight if r.catalogue]
    value = float(np.mean(chance)) if chance else None
    estimate = Estimate(value, value, value, len(chance))
    yield _metric("baseline_chance", "Baseline, chance: ranked first", estimate)


def _threshold(records: Records, key: str) -> float | None:
    """Return the threshold at which a baseline has as few false alarms as the diagnosis.

    None if every body lacks an effect.
    """
    silent = [r for r in records if r.silent and key in r.loudness]
    if not silent:
        return None
    alarms = sum(r.answer != NO_GAP for r in silent)
    return baseline_threshold([r.loudness[key] for r in silent], alarms)


def _right_first(records: Records) -> Estimate:
    return share([r.right_first for r in records])


def _none_of_these(records: Records) -> Estimate:
    return share([r.answer == NONE_OF_THESE for r in records])


def _both(
    records: Records,
    claimed: Callable[[CaseRecord], float | None],
    true: Callable[[CaseRecord], float | None],
) -> list[tuple[float, float]]:
    """Return claimed and true values of the cases for which both are known."""
    pairs = [(claimed(r), true(r)) for r in records]
    return [(c, t) for c, t in pairs if c is not None and t is not None]


def _within(
    records: Records,
    interval: Callable[[CaseRecord], tuple[float, float] | None],
    true: Callable[[CaseRecord], float | None],
) -> Estimate:
    """Return the share of intervals that cover the truth, where both are known."""
    both = [(interval(r), true(r)) for r in records]
    return share([i[0] <= t <= i[1] for i, t in both if i is not None and t is not None])


def _at_least(value: float) -> Target:
    return Target(value, True)


def _at_most(value: float) -> Target:
    return Target(value, False)


def _metric(
    key: str, title: str, estimate: Estimate, target: Target | None = None, unit: Unit = "share"
) -> Metric:
    met = None
    if target is not None and estimate.value is not None:
        met = target.met(estimate.value)
    return Metric(key, title, estimate, unit, target, met)

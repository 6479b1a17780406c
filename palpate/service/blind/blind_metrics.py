"""Metrics of a set and their targets.

A true gap counts as visible above 1.5 times the floor, the noise-free gap of the calibrated model
in the median control. Cases below that limit are listed but judged separately.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import median as middle
from typing import Literal

import numpy as np

from palpate.service.blind.answer_statistics import Estimate, mean, median, share
from palpate.service.blind.case_truth import MAPPED, CaseRecord
from palpate.service.blind.set_answering import baseline_threshold
from palpate.workers.diagnosis.verdict.cause_selection import NO_GAP

Unit = Literal["share", "part", "mm", "number"]
"""A share is a number of cases out of all; a part is a fraction of something else."""

VISIBLE = 1.5
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
    unit : {"share", "part", "mm", "number"}
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
        *_pairs_and_triples(records, floor),
        *_outside(records, floor),
        *_gaps(records),
        *_shrinkages(records),
        *_sizes(records),
        *_baselines(records, floor),
    ]


def _alarms(records: Records) -> Iterable[Metric]:
    alarms = share([r.answer != NO_GAP for r in records if r.silent])
    title = "False alarms on controls and hidden effects"
    yield _metric("false_alarms", title, alarms, _at_most(0.05))
    named = [r for r in records if r.named]
    acts = share([r.right_first for r in named])
    yield _metric("named_right", "The first named effect acts", acts, _at_least(0.95))
    complete = share([r.complete for r in named if r.group != "relative"])
    yield _metric("complete", "Exactly the acting effects are named", complete)


def _singles(records: Records, floor: float | None) -> Iterable[Metric]:
    in_sight = [r for r in records if r.group == "single" and visible(r, floor)]
    first = share([r.right_first for r in in_sight])
    title = "One effect, visible: named first"
    yield _metric("first_visible", title, first, _at_least(0.90))
    among = share([r.right_among((*r.primary, *r.rivals)) for r in in_sight])
    title = "One effect, visible: among the named effects and their rivals"
    yield _metric("among_visible", title, among)


def _pairs_and_triples(records: Records, floor: float | None) -> Iterable[Metric]:
    for group, count, *targets in (
        ("pair", "Two", _at_least(0.90), _at_least(0.40)),
        ("triple", "Three", None, None),
    ):
        in_sight = [r for r in records if r.group == group and visible(r, floor)]
        first = share([r.right_first for r in in_sight])
        title = f"{count} effects, visible: one of them is named first"
        yield _metric(f"{group}s_first", title, first, targets[0])
        complete = share([r.complete for r in in_sight])
        title = f"{count} effects, visible: all are named, and no other"
        yield _metric(f"{group}s_complete", title, complete, targets[1])


def _outside(records: Records, floor: float | None) -> Iterable[Metric]:
    in_sight = [r for r in records if visible(r, floor)]
    called = "answered none of these, or something else"
    unlike = share([r.outside for r in in_sight if r.group == "unlike"])
    title = f"Unlike any effect, visible: {called}"
    yield _metric("unlike_visible", title, unlike, _at_least(0.80))
    relatives = [r for r in in_sight if r.group == "relative"]
    title = f"Relative of an effect, visible: {called}"
    yield _metric("relatives_outside", title, share([r.outside for r in relatives]))
    family = share([r.right_first for r in relatives])
    title = "Relative of an effect, visible: family is named first"
    yield _metric("relatives", title, family, _at_least(0.80))


def _gaps(records: Records) -> Iterable[Metric]:
    before = both_known(records, lambda r: r.claimed_before_mm, lambda r: r.true_before_mm)
    error = mean([abs(c - t) for c, t in before])
    part = mean([abs(c - t) / t for c, t in before if t > 0])
    met = None if error.value is None else error.value <= GAP_MM or (part.value or 1.0) <= GAP_PART
    title = "Error of the nominal gap, or at most 25 % of it"
    yield Metric("gap_error", title, error, "mm", _at_most(GAP_MM), met)
    yield _metric("gap_error_part", "Relative error of the nominal gap", part, unit="part")
    slid = both_known(records, lambda r: r.claimed_before_mm, lambda r: r.true_material_mm)
    error = mean([abs(c - t) for c, t in slid])
    title = "Error of the nominal gap, measured at material points"
    yield _metric("gap_error_material", title, error, unit="mm")
    within = _within(records, lambda r: r.gap_interval_mm, lambda r: r.true_before_mm)
    yield _metric("gap_within", "True nominal gap within its 90 % interval", within)
    after = both_known(records, lambda r: r.claimed_after_mm, lambda r: r.true_after_mm)
    error = mean([abs(c - t) for c, t in after])
    yield _metric("gap_after_error", "Error of the gap with the named effects", error, unit="mm")


def _shrinkages(records: Records) -> Iterable[Metric]:
    within = _within(records, lambda r: r.share_interval, lambda r: r.true_share)
    yield _metric("shrinkage_within", "True shrinkage within its 90 % interval", within)
    for key, where, claimed in (
        ("claimed", "", lambda r: r.claimed_share),
        ("held_out", " on unseen scans", lambda r: r.held_out_share),
    ):
        error = mean([abs(c - t) for c, t in both_known(records, claimed, lambda r: r.true_share)])
        title = f"Error of the claimed shrinkage{where}"
        yield _metric(f"shrinkage_error_{key}", title, error, _at_most(0.12), "number")


def _sizes(records: Records) -> Iterable[Metric]:
    lumps = [(r.lump_apart_mm, MAPPED.name in r.primary) for r in records]
    named = mean([mm for mm, is_named in lumps if is_named and mm is not None])
    unnamed = mean([mm for mm, is_named in lumps if not is_named and mm is not None])
    title = "Lump is named: distance from its centre to the true one"
    yield _metric("lump", title, named, _at_most(3.0), "mm")
    title = "Lump is not named: distance from its fitted centre to the true one"
    yield _metric("lump_unnamed", title, unnamed, unit="mm")
    sizes = [m for r in records if r.right_first for m in r.magnitudes]
    errors = [abs(m.found - m.true) / m.sd for m in sizes if m.sd > 0]
    title = "Error of a magnitude in standard deviations"
    yield _metric("magnitude_sds", title, median(errors), unit="number")
    within = share([error <= 2 for error in errors])
    yield _metric("magnitude_within", "Magnitudes within two standard deviations", within)
    part = [abs(m.found / m.true - 1) for m in sizes if m.true]
    yield _metric("magnitude_part", "Relative error of a magnitude", median(part), unit="part")


def _baselines(records: Records, floor: float | None) -> Iterable[Metric]:
    """Score the baselines on the cases of `first_visible`."""
    in_sight = [r for r in records if r.group == "single" and visible(r, floor)]
    titles = {"raw_correlation": "largest raw correlation", "refit": "one refit at a time"}
    for key, title in titles.items():
        right = share([r.named_by.get(key) in r.effects for r in in_sight])
        yield _metric(f"baseline_{key}", f"Baseline, {title}: named first", right)
        least = _threshold(records, key)
        if least is not None:
            spoken = [
                r.named_by.get(key) in r.effects and r.loudness.get(key, 0.0) > least
                for r in in_sight
            ]
            also = f"Baseline, {title}, with as many false alarms: named first"
            yield _metric(f"baseline_{key}_silent", also, share(spoken))
    chance = [1 / r.catalogue for r in in_sight if r.catalogue]
    value = float(np.mean(chance)) if chance else None
    estimate = Estimate(value, value, value, len(chance))
    yield _metric("baseline_chance", "Baseline, chance: named first", estimate, unit="part")


def _threshold(records: Records, key: str) -> float | None:
    """Return the threshold at which a baseline has as many false alarms as the diagnosis.

    None if every body lacks an effect.
    """
    silent = [r for r in records if r.silent and key in r.loudness]
    if not silent:
        return None
    alarms = sum(r.answer != NO_GAP for r in silent)
    return baseline_threshold([r.loudness[key] for r in silent], alarms)


def both_known(
    records: Records,
    claimed: Callable[[CaseRecord], float | None],
    true: Callable[[CaseRecord], float | None],
) -> list[tuple[float, float]]:
    """Return claimed and true values of the cases for which both are known.

    Parameters
    ----------
    records : sequence of CaseRecord
    claimed, true : callable
        Map a record to a value or None.
    """
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

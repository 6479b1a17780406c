"""The page of a scored set, as one self-contained file."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from palpate.service.blind.report import charts
from palpate.service.blind.report.words import (
    answered,
    asked_for,
    interval,
    limit,
    millimetres,
    shown,
)
from palpate.service.blind.scoring.calibration import calibration_curve
from palpate.service.blind.scoring.confusion import confusion
from palpate.service.blind.scoring.metrics import Metric
from palpate.service.blind.scoring.scored_set import ScoredSet
from palpate.service.blind.scoring.statistics import Estimate
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.blind.sealed.truth import GROUPS
from palpate.service.report.drawing.pictures import Picture, picture
from palpate.service.report.page.template import filled
from palpate.service.versions import palpate_version

Pairs = list[tuple[float, float]]


def render(scored: ScoredSet) -> str:
    """Return the page as text; equal scores give identical bytes."""
    return filled("blind.html.j2", context(scored), Path(__file__).parent)


def context(scored: ScoredSet) -> dict[str, Any]:
    """Return all values of the template."""
    records, metrics = scored.records, scored.metrics
    judged = [f for f in metrics if f.met is not None]
    met = sum(1 for f in judged if f.met)
    return {
        "name": scored.name,
        "verdict": f"{met} of {len(judged)} targets are met on {len(records)} cases.",
        "lead": _lead(scored),
        "tiles": _tiles(metrics),
        "declared": scored.declared,
        "judged": [_row(f) for f in metrics if f.target is not None],
        "others": [_row(f) for f in metrics if f.target is None],
        "confusion": _confusion_picture(records),
        "calibration": _calibration_picture(records),
        "shrinkage": _shrinkage_picture(records),
        "gaps": _gap_picture(records, scored.floor_mm),
        "groups": [
            (title, sum(r.group == group for r in records)) for group, title in GROUPS.items()
        ],
        "failures": [_case(r) for r in records if not r.right],
        "cases": [_case(r) for r in records if r.right],
        "seals": scored.seals,
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _lead(scored: ScoredSet) -> str:
    floor = scored.floor_mm
    floor_text = (
        f"Without noise, the calibrated model of the median control still has a gap of {floor:.2f} "
        "mm, the floor. A gap counts as visible above 1.5 times the floor. "
        if floor is not None
        else ""
    )
    shown_scans = (
        "" if scored.seals[0]["directions"] == "all" else "Only scans pressed along y were shown. "
    )
    return (
        "Bodies were made by another solver and sealed before they were diagnosed; their causes "
        f"were known only to the maker. {shown_scans}{floor_text}Intervals are at 95 %."
    )


def _tiles(metrics: Sequence[Metric]) -> list[tuple[str, str, str]]:
    titles = {
        "false_alarms": "False alarms",
        "named_right": "Named effects that act",
        "first_visible": "Visible effects ranked first",
        "covered": "In the 90 % set",
    }
    by_key = {f.key: f for f in metrics}
    return [
        (title, shown(by_key[key].estimate.value, by_key[key].unit), _of(by_key[key].estimate))
        for key, title in titles.items()
    ]


def _of(estimate: Estimate) -> str:
    return f"of {estimate.count}" if estimate.count else "no case"


def _row(metric: Metric) -> dict[str, Any]:
    return {
        "title": metric.title,
        "value": shown(metric.estimate.value, metric.unit),
        "interval": interval(metric),
        "count": metric.estimate.count,
        "target": limit(metric),
        "met": metric.met,
    }


def _case(record: CaseRecord) -> dict[str, Any]:
    return {
        "id": record.name,
        "truth": asked_for(record),
        "group": GROUPS[record.group],
        "answer": answered(record),
        "reason": record.reason.splitlines()[0] if record.reason else "",
        "true_gap": millimetres(record.true_before_mm),
        "claimed_gap": millimetres(record.claimed_before_mm),
        "true_after": millimetres(record.true_after_mm),
    }


def _confusion_picture(records: Sequence[CaseRecord]) -> Picture:
    table = confusion(records)
    right = sum(r.right for r in records)
    return picture(
        charts.heat_map(table),
        f"Answers to {len(records)} cases of {len(table.rows)} kinds; {right} are correct.",
        "Rows: truth. Columns: first answer. Correct answers have a frame.",
    )


def _calibration_picture(records: Sequence[CaseRecord]) -> Picture:
    bins = calibration_curve(records)
    shares = "; ".join(
        f"{b.low:.1f} to {b.high:.1f}: {shown(b.came_true.value, 'share')} of {b.came_true.count}"
        for b in bins
        if b.came_true.count
    )
    return picture(
        charts.curve(bins),
        f"Share of true statements by probability. {shares}.",
        "Each dot shows the statements in a tenth of the scale, with their number.",
    )


def _shrinkage_picture(records: Sequence[CaseRecord]) -> Picture:
    held_out = _pairs(records, lambda r: r.held_out_share, lambda r: r.true_share)
    inside = _pairs(records, lambda r: r.claimed_share, lambda r: r.true_share)
    return picture(
        charts.shrinkage(held_out, inside),
        f"Claimed against true shrinkage of {len(inside)} cases.",
        "Reduction of the squared gap by the named effects.",
    )


def _gap_picture(records: Sequence[CaseRecord], floor: float | None) -> Picture:
    before = _pairs(records, lambda r: r.claimed_before_mm, lambda r: r.true_before_mm)
    after = _pairs(records, lambda r: r.claimed_after_mm, lambda r: r.true_after_mm)
    return picture(
        charts.gaps(before, after, floor),
        f"Claimed against true gap of {len(before)} cases.",
        "Root mean square distance beyond noise: claimed against noise-free.",
    )


def _pairs(
    records: Sequence[CaseRecord],
    claimed: Callable[[CaseRecord], float | None],
    true: Callable[[CaseRecord], float | None],
) -> Pairs:
    both = [(claimed(r), true(r)) for r in records]
    return [(c, t) for c, t in both if c is not None and t is not None]

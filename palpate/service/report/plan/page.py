"""The page of a plan, in one self-contained file."""

import json
from collections.abc import Iterator
from dataclasses import dataclass

from palpate.service.diagnosis.plan_words import (
    DIGITS,
    WHY,
    confusions,
    drift,
    gain,
    headline,
    nearest,
    silence,
)
from palpate.service.diagnosis.words import spoken, together
from palpate.service.formatting import NONE, number
from palpate.service.report.diagnosis.tables import parameter_name
from palpate.service.report.drawing.pictures import Picture, picture
from palpate.service.report.page.template import filled
from palpate.service.report.plan.figures import alikeness, gains
from palpate.service.versions import palpate_version
from palpate.storage.plain import to_plain
from palpate.storage.records.typed_json import to_json
from palpate.workers.diagnosis.schema.plan import FurtherMeasurement, PlannedEffect, PlanSummary


@dataclass(frozen=True)
class EffectRow:
    """One effect: its parameters with detectable and plausible magnitudes."""

    name: str
    family: str
    summary: str
    parameters: tuple[tuple[str, str, str], ...]
    absorbed: str
    evidence: str
    nearest: str
    verdict: str
    seen: bool


@dataclass(frozen=True)
class GainRow:
    """A further measurement."""

    name: str
    pairs: str
    minima: str
    gain: str
    silent: str


def render(plan: PlanSummary) -> str:
    """Return the page as text; equal plans give the same bytes."""
    return filled("plan.html.j2", context(plan))


def context(plan: PlanSummary) -> dict[str, object]:
    """Return all values of the template."""
    return {
        "name": plan.case,
        "caveats": plan.caveats or (),
        "headline": headline(plan),
        "lead": _lead(plan),
        "tiles": _tiles(plan),
        "notes": [
            text for text in (silence(plan), confusions(plan), drift(plan), *_lost(plan)) if text
        ],
        "effects": [_effect(e) for e in plan.effects],
        "alike_picture": picture(alikeness(plan), f"Cosines. {_alikes(plan)}.", on_paper=True),
        "gain_picture": _gain_picture(plan),
        "gains": [_gain(a) for a in plan.acquisitions],
        "json": json.dumps(to_plain(to_json(plan)), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _lead(plan: PlanSummary) -> str:
    return (
        f"Predicted at {plan.points} points on the outline and on the boundary of the glandular "
        f"tissue, for a segmentation error of {plan.noise_mm:.2f} mm at each. No loaded scan was "
        "used: the model predicts the influence of every effect, and how much of it other "
        "constants would absorb."
    )


def _tiles(plan: PlanSummary) -> list[tuple[str, str, str]]:
    seen = len(plan.effects) - len(plan.silent)
    return [
        ("Effects that can be found", str(seen), f"of {len(plan.effects)}"),
        ("Pairs distinguished", str(plan.told_apart), f"of {plan.pairs}"),
        ("Points", str(plan.points), f"in {len(plan.scans)} scans"),
        ("Noise of a point", f"{plan.noise_mm:.2f}", "mm"),
    ]


def _lost(plan: PlanSummary) -> Iterator[str]:
    if plan.not_simulated:
        yield f"The model does not converge for {', '.join(plan.not_simulated)}."
    if plan.without_columns:
        yield (
            f"Left out, because they do not act here or cannot be simulated: "
            f"{together(plan.without_columns)}."
        )


def _effect(e: PlannedEffect) -> EffectRow:
    return EffectRow(
        spoken(e.name),
        e.family,
        e.summary,
        tuple(
            (parameter_name(p.parameter, p.unit), _amount(least, unit), _amount(size, unit))
            for p in e.parameters
            for least, size, unit in [p.shown]
        ),
        f"{100 * e.absorbed_share:.0f} %",
        number(e.log_evidence, 3),
        nearest(e),
        WHY[e.why_not],
        e.seen,
    )


def _gain(a: FurtherMeasurement) -> GainRow:
    return GainRow(
        a.name,
        str(a.told_apart),
        f"× {a.minimum_ratio:.2f}",
        gain(a),
        together(a.silent) if a.silent else NONE,
    )


def _gain_picture(plan: PlanSummary) -> Picture | None:
    found = plan.acquisitions
    if not found:
        return None
    said = "; ".join(f"{a.name}: {a.told_apart}" for a in found)
    return picture(gains(plan.told_apart, found, plan.pairs), f"Pairs distinguished. {said}.")


def _alikes(plan: PlanSummary) -> str:
    return "; ".join(f"{spoken(e.name)}: {nearest(e)}" for e in plan.effects)


def _amount(value: float | None, unit: str) -> str:
    return NONE if value is None else f"{number(value, DIGITS)} {unit}".rstrip()

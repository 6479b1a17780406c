"""Plan of an acquisition in plain numbers, with ranked further measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.planning.candidate_loads import CandidateLoad
from palpate.workers.diagnosis.planning.experimental_design import (
    Design,
    DesignEvaluation,
    evaluate_design,
    loose,
    plausible,
    simulated,
)
from palpate.workers.diagnosis.planning.load_sensitivity import LoadSensitivity
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.schema.plan import (
    ConfusablePair,
    FurtherMeasurement,
    ParameterPlan,
    PlannedEffect,
    PlanSummary,
)
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.problem.loads import ForceControl
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.mechanics.readings import shown_change


def make_plan(
    name: str,
    unloaded: InverseProblem,
    loads: Sequence[CandidateLoad],
    sensitivities: Mapping[int, LoadSensitivity],
    effects: Sequence[Effect],
) -> PlanSummary:
    """Evaluate the planned loads, and rank further measurements by benefit.

    Parameters
    ----------
    name : str
        Name of the case.
    unloaded : InverseProblem
        The body at rest; see `workers.diagnosis.problem.acquisition.inverse_problem_of`.
    loads : sequence of CandidateLoad
        See `workers.diagnosis.planning.candidate_loads`.
    sensitivities : mapping of int to LoadSensitivity
        Sensitivities by index of the load; loads that cannot be simulated are missing.
    effects : sequence of Effect
        The catalogue.
    """
    present = _planned(loads, sensitivities)
    acting = simulated([sensitivities[n] for n in present], effects)
    now = evaluate_design(unloaded, Design(present), sensitivities, acting)
    shown = frozenset(
        row.name for row in now.rows if row.absorbed <= SETTINGS.detectability.sunk_share
    )
    further = []
    for option, design in designs(unloaded, loads, sensitivities).items():
        known = simulated([sensitivities[n] for n in design.states], acting)
        then = evaluate_design(unloaded, design, sensitivities, known)
        further.append(_further(option, now, replace(then, shown=shown)))
    return PlanSummary(
        case=name,
        scans=tuple(loads[n].name for n in present),
        points=len(unloaded.points),
        noise_mm=unloaded.noise.sd_mm,
        travel_mm={loads[n].name: one.travel_mm for n, one in sensitivities.items()},
        clear=SETTINGS.plan.clear,
        effects=tuple(_effect(e, now, i) for i, e in enumerate(acting)),
        cosines=tuple(map(tuple, now.cosines.tolist())),
        log_evidence=tuple(map(tuple, now.separation.tolist())),
        pairs=len(acting) * (len(acting) - 1) // 2,
        told_apart=len(now.apart()),
        confusable=tuple(_confusable(now)),
        silent=tuple(n for n, seen in zip(now.names, now.seen, strict=True) if not seen),
        not_simulated=tuple(one.name for n, one in enumerate(loads) if n not in sensitivities),
        loose=tuple(e.name for e in loose([sensitivities[n] for n in present], acting)),
        without_columns=tuple(e.name for e in effects if e not in acting),
        acquisitions=tuple(sorted(further, key=_rank)),
    )


def _planned(
    loads: Sequence[CandidateLoad], sensitivities: Mapping[int, LoadSensitivity]
) -> tuple[int, ...]:
    return tuple(n for n in sensitivities if loads[n].kind == "planned")


def designs(
    unloaded: InverseProblem,
    loads: Sequence[CandidateLoad],
    sensitivities: Mapping[int, LoadSensitivity],
) -> dict[str, Design]:
    """Return the possible further scans and measurements, by description."""
    present = _planned(loads, sensitivities)
    found = {
        ("a scan at " if loads[n].kind == "load" else "a view, ") + loads[n].name: Design(
            (*present, n)
        )
        for n in sensitivities
        if n not in present
    }
    found["a second segmentation of every scan"] = Design(present, drawings=2)
    middle = {f.name: float(np.exp(f.log_mean)) for f in unloaded.free}
    if any(isinstance(loads[n].problem(middle).load, ForceControl) for n in present):
        found[f"the plates' distance to {SETTINGS.plan.plates_sd_mm:g} mm"] = Design(
            present, plates=True
        )
    for number, free in enumerate(unloaded.free):
        if free.name.startswith("E_"):
            words = f"{free.name} measured separately to {100 * SETTINGS.plan.stiffness_sd:.0f} %"
            found[words] = Design(present, known=number)
            break
    return found


def _parameter(p: Parameter, least: float, sd: float) -> ParameterPlan:
    """Return the minimum detectable and a plausible magnitude."""
    minimum = p.unit.to_door(least) if np.isfinite(least) else None
    plausible_size = p.unit.to_door(sd)
    shown, unit = shown_change(p.reading, plausible_size, p.unit.symbol)
    found = None if minimum is None else shown_change(p.reading, minimum, "")[0]
    return ParameterPlan(p.door_name, p.unit.symbol, minimum, plausible_size, unit, found, shown)


def _effect(effect: Effect, now: DesignEvaluation, i: int) -> PlannedEffect:
    row = now.rows[i]
    sizes = plausible(effect)
    return PlannedEffect(
        name=effect.name,
        family=effect.family,
        summary=effect.summary,
        parameters=tuple(
            _parameter(p, float(least), sd)
            for p, least, sd in zip(effect.parameters, row.minimum, sizes, strict=False)
        ),
        absorbed_share=row.absorbed,
        nearest=row.nearest,
        cosine=row.cosine,
        log_evidence=float(now.evidence[i]),
        seen=bool(now.seen[i]),
        why_not="hidden" if now.hidden[i] else "" if now.seen[i] else "weak",
    )


def _confusable(now: DesignEvaluation) -> list[ConfusablePair]:
    """Return pairs of detectable effects that cannot be distinguished, the most similar first."""
    worst = sorted(now.pairs().items(), key=lambda item: item[1])
    order = now.names.index
    return [
        ConfusablePair(tuple(sorted(pair, key=order)), value)
        for pair, value in worst
        if value < SETTINGS.plan.clear
    ]


def _further(name: str, now: DesignEvaluation, then: DesignEvaluation) -> FurtherMeasurement:
    """Return the benefit of a design.

    Effects that cannot be simulated in it are ignored in both designs.
    """
    order = now.names.index
    known = set(then.names)
    before = {pair for pair in now.apart() if pair <= known}
    more = len(then.apart()) - len(before)
    confusable = {frozenset(pair.effects) for pair in _confusable(now)}
    rows = {row.name: row for row in now.rows}
    seen = dict(zip(now.names, now.seen, strict=True))
    ratios = {row.name: _ratio(rows[row.name].minimum, row.minimum) for row in then.rows}
    visible = list(zip(then.names, then.seen, strict=True))
    separates = sorted(sorted(pair, key=order) for pair in confusable & then.apart())
    return FurtherMeasurement(
        name=name,
        told_apart=len(now.apart()) + more,
        more_told_apart=more,
        separates=tuple(map(tuple, separates)),
        reveals=tuple(n for n, shown in visible if shown and not seen[n]),
        silent=tuple(n for n, shown in visible if not shown),
        minimum_ratio=float(np.exp(np.mean(np.log(list(ratios.values()))))),
        minimum_ratios=ratios,
        absorbed_shares={row.name: row.absorbed for row in then.rows},
        not_simulated=tuple(n for n in now.names if n not in known),
    )


def _ratio(before: FloatArray, after: FloatArray) -> float:
    """Return the geometric mean, over parameters, of the minimum magnitudes after over before."""
    both = np.isfinite(before) & np.isfinite(after)
    return float(np.exp(np.mean(np.log(after[both] / before[both])))) if both.any() else 1.0


def _rank(further: FurtherMeasurement) -> tuple[int, int, float, str]:
    return (
        -further.more_told_apart,
        -len(further.separates),
        further.minimum_ratio,
        further.name,
    )

"""Plan of an acquisition in plain numbers, with ranked further loads and measurements.

A further load between the same plates is lighter than the lightest or heavier than the heaviest
planned load; a further view rotates the plates about z. Rotated plates with a given force start at
the ends of the body; rotated plates at a given distance close by the same share of the body. The
chest wall is then held along x and y with the larger of its two stiffnesses, since plates do not
hold the body where they slide.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.expected_information import (
    Design,
    DesignEvaluation,
    LoadSensitivity,
    evaluate_design,
    loose,
    plausible,
    simulated,
)
from palpate.workers.diagnosis.plan_summary import (
    ConfusablePair,
    FurtherMeasurement,
    ParameterPlan,
    PlannedEffect,
    PlanSummary,
)
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, Values
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition, ProblemBuilder
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    DistanceControl,
    ForceControl,
    Load,
    Wall,
)
from palpate.workers.mechanics.model_parameters import Parameter, shown_change

Kind = Literal["planned", "load", "view"]

HALF = float(np.sqrt(0.5))
# A further measurement that needs no scan.
REDRAWN = "a second segmentation of every scan"
VIEWS: tuple[tuple[str, Triple], ...] = (
    ("y", (0.0, 1.0, 0.0)),
    ("x", (1.0, 0.0, 0.0)),
    ("45 degrees", (HALF, HALF, 0.0)),
)


@dataclass(frozen=True, eq=False)
class CandidateLoad:
    """A planned or possible loaded scan.

    Parameters
    ----------
    name : str
        Name shown in a report.
    kind : {"planned", "load", "view"}
        A load in the case itself, a further load, or a further direction of the plates.
    problem : callable
    """

    name: str
    kind: Kind
    problem: ProblemBuilder


def candidate_loads(
    acquisition: Acquisition, frame: Frame, nodes_mm: FloatArray
) -> list[CandidateLoad]:
    """Return the loads of an acquisition, in order, followed by possible further loads.

    Parameters
    ----------
    acquisition : Acquisition
    frame : Frame
        Frame of the body.
    nodes_mm : ndarray, shape (n, 3)
        Nodes at rest, which give the extent of the body in the direction of the plates.
    """
    builders = [acquisition.problem(number, frame) for number in range(len(acquisition.loads))]
    planned = [
        CandidateLoad(name, "planned", build)
        for name, build in zip(acquisition.loads, builders, strict=True)
    ]
    middle = {f.name: float(np.exp(f.log_mean)) for f in acquisition.free}
    loads = [builder(middle).load for builder in builders]
    pressed = [
        n for n, load in enumerate(loads) if isinstance(load, ForceControl | DistanceControl)
    ]
    if not pressed:
        return planned
    strength = {n: _strength(loads[n], nodes_mm) for n in pressed}
    heaviest = max(pressed, key=lambda n: strength[n])
    axis = _axis(loads[heaviest])
    along = [n for n in pressed if _alike(_axis(loads[n]), axis)]
    lightest = min(along, key=lambda n: strength[n])
    return [
        *planned,
        _pressed(builders[lightest], SETTINGS.plan.lighter, nodes_mm, middle),
        _pressed(builders[heaviest], SETTINGS.plan.heavier, nodes_mm, middle),
        *_views(builders[heaviest], [_axis(loads[n]) for n in pressed], nodes_mm, middle),
    ]


def pressed_by(load: Load, factor: float, nodes_mm: FloatArray) -> Load:
    """Return the load with its force, or the closure of its plates, scaled by `factor`."""
    if isinstance(load, ForceControl):
        return replace(load, force_n=factor * load.force_n)
    if isinstance(load, DistanceControl):
        low, high = _reach(load, nodes_mm)
        share = min(factor, SETTINGS.plan.farther)
        return replace(
            load,
            lower_mm=low + share * (load.lower_mm - low),
            upper_mm=high + share * (load.upper_mm - high),
        )
    return load


def turned_to(load: Load, axis: Triple, nodes_mm: FloatArray) -> Load:
    """Return the load applied along another axis."""
    turned = replace(load, device=replace(load.device, axis=axis))
    if isinstance(turned, ForceControl):
        low, high = _reach(turned, nodes_mm)
        return replace(turned, lower_mm=low, upper_mm=high)
    if isinstance(turned, DistanceControl) and isinstance(load, DistanceControl):
        before, (low, high) = _reach(load, nodes_mm), _reach(turned, nodes_mm)
        left = (load.upper_mm - load.lower_mm) / (before[1] - before[0])
        spare = (1 - left) * (high - low) / 2
        return replace(turned, lower_mm=low + spare, upper_mm=high - spare)
    return turned


def held_alike(wall: Wall) -> Wall:
    """Return the wall with its stiffer tangential spring along both x and y."""
    x, y, z = wall.spring_mpa_per_mm
    held = (wall.held[0] or wall.held[1],) * 2
    return Wall((*held, wall.held[2]), (max(x, y), max(x, y), z))


def _views(
    builder: ProblemBuilder, taken: Sequence[Triple], nodes_mm: FloatArray, middle: Values
) -> list[CandidateLoad]:
    views = []
    for name, axis in VIEWS:
        if not any(_alike(axis, other) for other in taken):

            def change(problem: Problem, axis: Triple = axis) -> Problem:
                load = turned_to(problem.load, axis, nodes_mm)
                return replace(problem, load=load, wall=held_alike(problem.wall))

            view = _changed(builder, change, middle)
            views.append(replace(view, name=f"{view.name} along {name}", kind="view"))
    return views


def _pressed(
    builder: ProblemBuilder, factor: float, nodes_mm: FloatArray, middle: Values
) -> CandidateLoad:
    def change(problem: Problem) -> Problem:
        return replace(problem, load=pressed_by(problem.load, factor, nodes_mm))

    return _changed(builder, change, middle)


def _changed(
    builder: ProblemBuilder, change: Callable[[Problem], Problem], middle: Values
) -> CandidateLoad:
    def build(values: Values) -> Problem:
        return change(builder(values))

    return CandidateLoad(_named(build(middle).load), "load", build)


def _named(load: Load) -> str:
    if isinstance(load, ForceControl):
        return f"{load.force_n:.3g} N"
    if isinstance(load, DistanceControl):
        return f"{load.upper_mm - load.lower_mm:.3g} mm"
    return "no plates"


def _strength(load: Load, nodes_mm: FloatArray) -> float:
    """Return the strength of a load: its force, or the fraction by which the plates close."""
    if isinstance(load, ForceControl):
        return load.force_n
    if isinstance(load, DistanceControl):
        low, high = _reach(load, nodes_mm)
        return 1 - (load.upper_mm - load.lower_mm) / (high - low)
    return 0.0


def _reach(load: Load, nodes_mm: FloatArray) -> tuple[float, float]:
    """Return the lowest and highest position of the body at rest along the axis."""
    heights = nodes_mm @ (np.asarray(_axis(load)) / np.linalg.norm(_axis(load)))
    return float(heights.min()), float(heights.max())


def _axis(load: Load) -> Triple:
    return load.device.axis


def _alike(first: Triple, second: Triple) -> bool:
    a, b = np.asarray(first), np.asarray(second)
    return bool(abs(a @ b) > SETTINGS.plan.same_view_cosine * np.linalg.norm(a) * np.linalg.norm(b))


def make_plan(
    name: str,
    unloaded: InverseProblem,
    loads: Sequence[CandidateLoad],
    sensitivities: Mapping[int, LoadSensitivity],
    effects: Sequence[Effect],
    each: Each = map,
) -> PlanSummary:
    """Evaluate the planned loads, and rank further measurements by benefit.

    Parameters
    ----------
    name : str
        Name of the case.
    unloaded : InverseProblem
        The body at rest; see `workers.diagnosis.problem.planned_acquisition.inverse_problem_of`.
    loads : sequence of CandidateLoad
        See `workers.diagnosis.scan_plan`.
    sensitivities : mapping of int to LoadSensitivity
        Sensitivities by index of the load; loads that cannot be simulated are missing.
    effects : sequence of Effect
        The catalogue.
    each : callable
        Applies a function to every item; see `workers.kernels_and_threads`.
    """
    present = _planned(loads, sensitivities)
    acting = simulated([sensitivities[n] for n in present], effects)
    now = evaluate_design(unloaded, Design(present), sensitivities, acting)
    shown = frozenset(
        row.name for row in now.rows if row.absorbed <= SETTINGS.detectability.sunk_share
    )

    def weighed(option: tuple[str, Design]) -> FurtherMeasurement:
        known = simulated([sensitivities[n] for n in option[1].states], acting)
        then = evaluate_design(unloaded, option[1], sensitivities, known)
        return _further(option[0], now, replace(then, shown=shown))

    further = each(weighed, designs(unloaded, loads, sensitivities).items())
    return PlanSummary(
        case=name,
        scans=tuple(loads[n].name for n in present),
        points=len(unloaded.points),
        noise_mm=unloaded.noise.sd_mm,
        travel_mm={loads[n].name: load.travel_mm for n, load in sensitivities.items()},
        named_above=SETTINGS.selection.first,
        apart_above=SETTINGS.selection.tie,
        effects=tuple(_effect(e, now, i) for i, e in enumerate(acting)),
        cosines=tuple(map(tuple, now.cosines.tolist())),
        log_evidence=tuple(map(tuple, now.separation.tolist())),
        pairs=len(acting) * (len(acting) - 1) // 2,
        told_apart=len(now.apart()),
        confusable=tuple(_confusable(now)),
        silent=tuple(n for n, seen in zip(now.names, now.seen, strict=True) if not seen),
        not_simulated=tuple(load.name for n, load in enumerate(loads) if n not in sensitivities),
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
    options = {
        ("a scan at " if loads[n].kind == "load" else "a view, ") + loads[n].name: Design(
            (*present, n)
        )
        for n in sensitivities
        if n not in present
    }
    options[REDRAWN] = Design(present, drawings=2)
    middle = {f.name: float(np.exp(f.log_mean)) for f in unloaded.free}
    if any(isinstance(loads[n].problem(middle).load, ForceControl) for n in present):
        options[f"the plates' distance to {SETTINGS.plan.plates_sd_mm:g} mm"] = Design(
            present, plates=True
        )
    for number, free in enumerate(unloaded.free):
        if free.name.startswith("E_"):
            words = f"{free.name} measured separately to {100 * SETTINGS.plan.stiffness_sd:.0f} %"
            options[words] = Design(present, known=number)
            break
    return options


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
        if value <= SETTINGS.selection.tie
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
        not_simulated=tuple(n for n in now.names if n not in known),
    )


def _ratio(before: FloatArray, after: FloatArray) -> float:
    """Return the geometric mean, over parameters, of the minimum magnitudes after over before."""
    both = np.isfinite(before) & np.isfinite(after)
    return float(np.exp(np.mean(np.log(after[both] / before[both])))) if both.any() else 1.0


def _rank(further: FurtherMeasurement) -> tuple[int, int, float, str]:
    return (-further.more_told_apart, -len(further.separates), further.minimum_ratio, further.name)

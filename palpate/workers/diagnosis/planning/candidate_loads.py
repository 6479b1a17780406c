"""Planned loads and possible further loads.

A further load between the same plates is lighter than the lightest or heavier than the heaviest
planned load; a further view rotates the plates about z. Rotated plates with a given force start at
the ends of the body; rotated plates at a given distance close by the same share of the body. The
chest wall is then held along x and y with the larger of its two stiffnesses, since plates do not
hold the body where they slide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.problem.acquisition import Acquisition, ProblemBuilder
from palpate.workers.diagnosis.problem.inverse_problem import Values
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import DistanceControl, ForceControl, Load, Wall

Kind = Literal["planned", "load", "view"]

HALF = float(np.sqrt(0.5))
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
    found = []
    for name, axis in VIEWS:
        if not any(_alike(axis, other) for other in taken):

            def change(problem: Problem, axis: Triple = axis) -> Problem:
                load = turned_to(problem.load, axis, nodes_mm)
                return replace(problem, load=load, wall=held_alike(problem.wall))

            one = _changed(builder, change, middle)
            found.append(replace(one, name=f"{one.name} along {name}", kind="view"))
    return found


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

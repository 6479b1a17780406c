"""Checks of effects."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Tissue
from palpate.testing.plugin_claims import (
    HALF_MM,
    busy_problem,
    check_pickles,
    claim,
    plain_problem,
    small_breast,
)
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.organs.organ_plugins import catalogue_of, organ_names, organ_spec

FRAME = Frame((1.0, -2.0, 20.0), (float(HALF_MM[0]), float(HALF_MM[1]), float(HALF_MM[2])))
NODES = 500
# Tolerance relative to the largest displacement; linear systems are solved to `SOLVED_TO`.
SLOPE_ERROR = 0.01
SOLVED_TO = 1e-6
STEP = 1e-3
LEAST_MM = 1e-4


def check_effect(effect: Effect, problem: Problem | None = None, step: float = STEP) -> None:
    """Check the contract of an effect.

    It can be pickled; its parameter names are unique and include their units; at its neutral values
    it changes nothing; at plausible values it changes something; nothing is changed in place; and
    the derivatives with respect to its parameters agree with finite differences of full solutions.

    Parameters
    ----------
    effect : Effect
    problem : Problem, optional
        Problem that it acts on. Default: a small breast between plates.
    step : float
        Step of the parameters for differences, in standard deviations; larger for an effect with
        an iterative solution.

    Raises
    ------
    AssertionError
        Naming the first violated condition.
    """
    check_pickles(effect, f"The effect {effect.name}")
    _check_names(effect)
    for parameter in effect.parameters:
        _check_parameter(effect, parameter.name)
    base = problem or plain_problem()
    for example in (base, *([] if problem else [busy_problem()])):
        _check_neutral(effect, example)
    if effect.observation is not None:
        _check_observation(effect, base)
    else:
        _check_body(effect, base, step)


def _check_names(effect: Effect) -> None:
    claim(effect.summary.endswith("."), f"The summary of {effect.name} is not a sentence.")
    claim(effect.references, f"{effect.name} names no reference.")
    names = effect.names
    claim(len(set(names)) == len(names), f"{effect.name} has duplicate parameters: {names}.")
    for organ in organ_names():
        others = [e for e in catalogue_of(organ).effects if e.name != effect.name]
        taken = {name for e in others for name in e.names}
        constants = {p.name for p in organ_spec(organ).parameters} - set(names)
        both = (taken | constants) & set(names)
        claim(
            not both,
            f"{effect.name} has parameter names that {organ} already uses: {sorted(both)}.",
        )


def _check_parameter(effect: Effect, name: str) -> None:
    k = effect.names.index(name)
    parameter, sd, step = effect.parameters[k], effect.prior_sd[k], effect.steps[k]
    neutral = effect.neutral[name]
    where = f"{effect.name}: {name}"
    claim(parameter.description, f"{where} has no description.")
    claim(
        parameter.lower <= neutral <= parameter.upper,
        f"{where} has the neutral value {neutral:g}, outside {parameter.lower:g} to "
        f"{parameter.upper:g}.",
    )
    span = parameter.upper - parameter.lower
    claim(
        step < sd <= 2 * span,
        f"{where} needs step < prior_sd <= twice its interval, found {step:g}, {sd:g}, {span:g}.",
    )
    try:
        parameter.check(neutral)
        effect.complete({name: effect.plausible[name]})
    except InputError as error:
        raise AssertionError(f"{where}: {error}") from None
    if parameter.unit.symbol:
        claim(parameter.door_name != name, f"{where} has a unit that is missing from its name.")


def _check_neutral(effect: Effect, problem: Problem) -> None:
    claim(effect.apply(problem, {}, FRAME) is problem, f"{effect.name} changes a neutral problem.")
    before = deepcopy(problem)
    neutral = effect.transform(problem, effect.neutral, FRAME)
    claim(
        _same(replace(neutral, variations=problem.variations, fibres=problem.fibres), problem),
        f"{effect.name} changes the problem at its neutral values.",
    )
    points = np.random.default_rng(0).uniform(-40, 40, (20, 3))
    uneven = any(v.log_factor(points).any() for v in neutral.variations)
    turned = neutral.fibres.directions(points) - problem.fibres.directions(points)
    claim(not uneven, f"{effect.name} varies the stiffness at its neutral values.")
    claim(not turned.any(), f"{effect.name} rotates the fibres at its neutral values.")
    effect.apply(problem, effect.plausible, FRAME)
    claim(problem == before, f"{effect.name} changes a problem in place.")


def _check_observation(effect: Effect, problem: Problem) -> None:
    points, normals, tissues = _interface()
    body = (points, normals, tissues)
    claim(
        effect.apply(problem, effect.plausible, FRAME) == problem,
        f"{effect.name} acts on the observation but changes the body.",
    )
    assert effect.observation is not None
    columns = effect.observation(*body, FRAME)
    claim(
        columns.shape == (len(points), len(effect.parameters)),
        f"{effect.name} must return one row per point and one column per parameter, "
        f"{(len(points), len(effect.parameters))}, found {columns.shape}.",
    )
    claim(np.isfinite(columns).all(), f"{effect.name} moves points by non-finite amounts.")
    claim(columns.any(axis=0).all(), f"{effect.name} has a parameter that moves no point.")


def _check_body(effect: Effect, problem: Problem, step: float) -> None:
    model = _model()
    frame = frame_of(model.finest.nodes)
    claim(
        effect.acts_on(problem, frame),
        f"{effect.name} changes nothing at plausible values; give a problem that it acts on.",
    )
    base = replace(problem, tolerance_mm=1e-9)
    # A one-sided effect may have a kink at its neutral value, and a position means nothing there.
    point = effect.neutral if effect.is_proportional else _halfway(effect)
    here = _solved(effect, effect.apply(base, point, frame))
    if effect.follows_path:
        return
    slopes = tangents(here, effect.changes(base, frame, point), SOLVED_TO)
    for k, parameter in enumerate(effect.parameters):
        expected = _difference(effect, base, point, parameter.name, here, step)
        largest = float(np.abs(expected).max()) * effect.prior_sd[k]
        if effect.place is None:
            claim(largest > LEAST_MM, f"{effect.name}: {parameter.name} moves no node.")
        error = float(np.abs(slopes[k] - expected).max()) * effect.prior_sd[k]
        share = error / max(largest, LEAST_MM)
        claim(
            share < SLOPE_ERROR,
            f"{effect.name}: the derivative with respect to {parameter.name} is off by "
            f"{share:.1%} of the largest displacement; `steps` may be too long, or the effect "
            "depends on the load path (`follows_path`).",
        )


def _difference(
    effect: Effect, base: Problem, at: dict[str, float], name: str, here: Equilibrium, step: float
) -> FloatArray:
    """Differentiate the solution with respect to one parameter, by Richardson extrapolation."""
    h = step * effect.prior_sd[effect.names.index(name)]

    def slope(h: float) -> FloatArray:
        ahead, behind = (_moved(effect, base, {**at, name: at[name] + s}, here) for s in (h, -h))
        return (ahead - behind) / (2 * h)

    return (4 * slope(h / 2) - slope(h)) / 3


def _halfway(effect: Effect) -> dict[str, float]:
    return {n: (v + effect.neutral[n]) / 2 for n, v in effect.plausible.items()}


def _moved(
    effect: Effect, base: Problem, values: dict[str, float], start: Equilibrium
) -> FloatArray:
    frame = frame_of(_model().finest.nodes)
    moved: FloatArray = _solved(
        effect, effect.apply(base, values, frame), start
    ).solution.displacement_mm
    return moved


def _solved(effect: Effect, problem: Problem, start: Equilibrium | None = None) -> Equilibrium:
    found = equilibrium(_model(), problem, start)
    reason = found.solution.outcome.reason
    claim(not reason, f"{effect.name}: no equilibrium was found: {reason}.")
    return found


@cache
def _model() -> Model:
    return prepare(build_hierarchy(small_breast(), nodes=NODES))


def _interface() -> tuple[FloatArray, FloatArray, IntArray]:
    rng = np.random.default_rng(7)
    normals = rng.standard_normal((60, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = np.asarray(FRAME.centre_mm) + normals * HALF_MM
    tissues = rng.choice([t for t in Tissue if t != Tissue.AIR], 60)
    return points, normals, tissues.astype(np.int32)


def _same(a: object, b: object) -> bool:
    """Return True if two problems are equal up to rounding."""
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) <= 1e-13 * max(abs(a), abs(b)) + 1e-15
    fields = getattr(a, "__dataclass_fields__", None)
    if fields is not None:
        return type(a) is type(b) and all(_same(getattr(a, f), getattr(b, f)) for f in fields)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(_same(p, q) for p, q in zip(a, b, strict=True))
    return bool(a == b)

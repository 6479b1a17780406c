"""The scans as a hypothesis predicts them: residuals, and their derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray, IntArray, Tissue
from workers.diagnosis.subject import Scan, Subject, Unknowns
from workers.effects.base import Effect
from workers.effects.friction import FRICTION
from workers.fem.fields import Frame
from workers.fem.problem import Problem
from workers.fem.sensitivity import RELATIVE_ERROR, Change, tangents
from workers.fem.solve import Equilibrium, equilibrium

# Difference of the logarithm of a constant.
LOG_STEP = 1e-4
# Difference of friction in prior standard deviations. Friction sets in with full force and
# then tires: its tangent at zero is several times too steep.
STEP = 0.2
# Within this, in the same unit, the derivative by friction is taken over.
NEAR = 0.15


@dataclass(frozen=True, eq=False)
class View:
    """One scan under one set of parameters.

    Parameters
    ----------
    at : Equilibrium
    points : ndarray, shape (k, 3)
        Where the points of the interfaces have gone.
    residual : ndarray, shape (k,)
        In mm, positive outside of the observed tissue.
    normals : ndarray, shape (k, 3)
        Of the observed interfaces.
    """

    at: Equilibrium
    points: FloatArray
    residual: FloatArray
    normals: FloatArray


def tissues_of(subject: Subject) -> IntArray:
    """The tissue that the interface of each point encloses: fat for the outline."""
    outline = subject.points.interface == 0
    return np.where(outline, Tissue.FAT, Tissue.GLANDULAR).astype(np.int32)


def problem_of(scan: Scan, unknowns: Unknowns, z: FloatArray, frame: Frame,
               leave_out: Effect | None = None) -> Problem:  # fmt: skip
    """The problem of a scan with all effects of a hypothesis but one."""
    problem = scan.problem(unknowns.constants(z))
    for effect in unknowns.effects:
        if effect is not leave_out:
            problem = effect.apply(problem, unknowns.of_effect(effect, z), frame)
    return problem


def view(
    subject: Subject, scan: Scan, unknowns: Unknowns, z: FloatArray, start: Equilibrium | None
) -> View | None:
    """Simulate one scan; None if the simulation does not converge."""
    at = equilibrium(subject.model, problem_of(scan, unknowns, z, subject.frame), start)
    return seen(subject, scan, unknowns, z, at) if at.solution.outcome.converged else None


def seen(subject: Subject, scan: Scan, unknowns: Unknowns, z: FloatArray, at: Equilibrium) -> View:
    """Compare an equilibrium with the scan."""
    points = subject.points.points + subject.at_points @ at.solution.displacement_mm
    r, normals = scan.look(points, subject.points)
    tissues = tissues_of(subject)
    for effect in unknowns.effects:
        if effect.observation is not None:
            values = unknowns.of_effect(effect, z)
            places = _seen_by(effect, subject, at)
            r = r + effect.shift(places, normals, tissues, values, subject.frame)
    return View(at, points, r, normals)


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivatives of one scan by all parameters, shape (k, p), and where they were taken.

    Fresh unless a column was taken over from a place nearby.
    """

    z: FloatArray
    columns: FloatArray
    fresh: bool = True


def derivatives(
    subject: Subject,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    seen_now: View,
    before: Slope | None = None,
) -> Slope:
    """Of the residual by every parameter.

    With friction the path of the load counts, of which tangents know the last step only:
    good enough for other parameters, but that of friction comes from another simulation,
    unless `before` was taken at about the same friction.
    """
    changes = [_log_change(subject, scan, unknowns, z, i) for i in range(len(unknowns.free))]
    for effect in unknowns.effects:
        if effect.observation is None:
            base = problem_of(scan, unknowns, z, subject.frame, leave_out=effect)
            values = unknowns.of_effect(effect, z)
            changes.extend(effect.changes(base, subject.frame, values))
    observed = [e for e in unknowns.effects if e.observation is not None]
    moved = columns_of(
        subject, seen_now, changes, [(e, unknowns.of_effect(e, z)) for e in observed]
    )
    found = _with_observed(subject, unknowns, seen_now, moved)
    if FRICTION in unknowns.effects:
        at = unknowns.names.index(FRICTION.names[0])
        if before is not None and abs(z[at] - before.z[at]) < NEAR * unknowns.sd[at]:
            # The place where that column was taken stays: it must not drift.
            found[:, at] = before.columns[:, at]
            z = np.where(np.arange(len(z)) == at, before.z, z)
            return Slope(z, found, fresh=False)
        found[:, at] = _by_solving(subject, scan, unknowns, z, seen_now, at)
    return Slope(z, found)


def _by_solving(
    subject: Subject, scan: Scan, unknowns: Unknowns, z: FloatArray, seen_now: View, at: int
) -> FloatArray:
    """The column of parameter number `at`; zero where the simulation fails."""
    h = STEP * unknowns.sd[at]
    ahead = z.copy()
    ahead[at] += h
    found = view(subject, scan, unknowns, ahead, seen_now.at)
    if found is None:
        return np.zeros_like(seen_now.residual)
    return (found.residual - seen_now.residual) / h


def columns_of(
    subject: Subject,
    seen_now: View,
    changes: Sequence[Change],
    observed: Sequence[tuple[Effect, Mapping[str, float]]] = (),
    tolerance: float = RELATIVE_ERROR,
) -> FloatArray:
    """Derivatives of the residual by changes of the problem, shape (k, c).

    `observed` are the effects on the observation that act, with their values: a point that
    moves is seen elsewhere. `tolerance` is that of `tangents`.
    """
    dx = tangents(seen_now.at, changes, tolerance)
    out = np.empty((len(seen_now.residual), len(changes)))
    for c, nodal in enumerate(dx):
        out[:, c] = ((subject.at_points @ nodal) * seen_now.normals).sum(axis=1)
        for effect, values in observed:
            out[:, c] += _shift_along(subject, seen_now, effect, values, nodal)
    return out


def _shift_along(
    subject: Subject, seen_now: View, effect: Effect, values: Mapping[str, float], u: FloatArray
) -> FloatArray:
    """Derivative of `Effect.shift`, affine in what the effect sees, along nodal motion `u`."""
    here = _seen_by(effect, subject, seen_now.at)
    step = _moves(effect, subject, u)
    rest = seen_now.normals, tissues_of(subject), values, subject.frame
    return effect.shift(here + step, *rest) - effect.shift(here, *rest)


def observed_columns(subject: Subject, effect: Effect, seen_now: View) -> FloatArray:
    """Derivatives by the parameters of an effect on the observation, shape (k, q)."""
    if effect.observation is None:
        raise ValueError(f"{effect.name} acts on the body")
    places = _seen_by(effect, subject, seen_now.at)
    return effect.observation(places, seen_now.normals, tissues_of(subject), subject.frame)


def _seen_by(effect: Effect, subject: Subject, at: Equilibrium) -> FloatArray:
    """What an effect on the observation is given as points; see `Effect.sees`."""
    moved = _moves(effect, subject, at.solution.displacement_mm)
    return subject.points.points + moved if effect.sees == "points" else moved


def _moves(effect: Effect, subject: Subject, u: FloatArray) -> FloatArray:
    """How motion `u` of the nodes moves what an effect sees, shape (k, 3)."""
    if effect.sees != "arms":
        return np.asarray(subject.at_points @ u)
    if subject.arms is None:
        raise ValueError(f"{effect.name} needs markers")
    return np.asarray(subject.arms @ u)


def _log_change(subject: Subject, scan: Scan, unknowns: Unknowns, z: FloatArray, i: int) -> Change:
    ahead, behind = z.copy(), z.copy()
    ahead[i] += LOG_STEP
    behind[i] -= LOG_STEP
    plus, minus = (problem_of(scan, unknowns, at, subject.frame) for at in (ahead, behind))
    return Change(plus, minus, 2 * LOG_STEP)


def _with_observed(
    subject: Subject, unknowns: Unknowns, seen_now: View, moved: FloatArray
) -> FloatArray:
    """Put the columns of effects on the observation where they belong."""
    parts, at = [moved[:, : len(unknowns.free)]], len(unknowns.free)
    for effect in unknowns.effects:
        if effect.observation is None:
            q = len(effect.names)
            parts.append(moved[:, at : at + q])
            at += q
        else:
            parts.append(observed_columns(subject, effect, seen_now))
    return np.hstack(parts)

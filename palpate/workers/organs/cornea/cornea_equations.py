"""The equations of a cornea and their solution: Newton's method in adaptive load steps.

A `System` gives the out-of-balance force and the tangent under a stage of the load. Newton's method
reuses a factored tangent while it is useful. Steps are judged by the next correction with the same
factors, an error in mm that does not depend on the stiffness of a direction (the natural
monotonicity test; P. Deuflhard, Newton Methods for Nonlinear Problems, 2004, ch. 3): the membrane
of a cornea is a thousand times stiffer than its bending, so a residual in N is not informative. If
that correction is much shorter than the step, the factors are reused, which saves an assembly and a
factorisation.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.cornea_problem import PreparedMesh, point_geometry
from palpate.workers.organs.cornea.corneal_model import CorneaConstants, CorneaLoad, OgdenLaw
from palpate.workers.organs.cornea.envelope_lu import Factors, factorise, new_values
from palpate.workers.organs.cornea.t6_elements import (
    NOTHING,
    Elements,
    SurfacePoints,
    add_pressure,
    assemble,
    jet_points,
)


class Prestress(NamedTuple):
    """The state of the imaged cornea; each method of `prestress` uses a part of it.

    Parameters
    ----------
    initial_stress : ndarray, shape (m, q, 4)
        S11, S22, S12, S33 in MPa.
    prestretch : ndarray, shape (m, q, 4)
        F11, F12, F21, F22 from the stress-free state to `rest_mm`.
    out_of_plane : ndarray, shape (m, q)
        Stretch along z or around the axis from the stress-free state to the image.
    rest_mm : ndarray, shape (n, 2)
        Nodes without pressure.
    support_mm : ndarray, shape (k, 2)
        Positions at which the elastic support of the limbus carries no force.
    """

    initial_stress: FloatArray
    prestretch: FloatArray
    out_of_plane: FloatArray
    rest_mm: FloatArray
    support_mm: FloatArray


class Stage(NamedTuple):
    """Pressures in MPa and the fraction of the motion of the eye."""

    iop_mpa: float
    jet_mpa: float
    motion: float

    def towards(self, other: "Stage", fraction: float) -> "Stage":
        """Return the stage at a fraction of the way to another one."""
        return Stage(*(a + fraction * (b - a) for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class System:
    """A cornea with its constants, load and prestress.

    Parameters
    ----------
    prepared : PreparedMesh
    law : OgdenLaw
    load : CorneaLoad
    jet : SurfacePoints
    prestress : Prestress
    elements : Elements
    """

    prepared: PreparedMesh
    law: OgdenLaw
    load: CorneaLoad
    jet: SurfacePoints
    prestress: Prestress
    elements: Elements

    @property
    def image_stage(self) -> Stage:
        """Return the stage in the image of the undeformed cornea."""
        return Stage(self.load.iop_mpa, 0.0, 0.0)

    @property
    def jet_stage(self) -> Stage:
        """Return the stage under the full jet."""
        load = self.load
        return Stage(load.iop_mpa + load.iop_rise_mpa, load.jet_pressure_mpa, 1.0)

    def with_prestress(self, prestress: Prestress) -> "System":
        """Return the system in another state of prestress."""
        elements = _elements(self.prepared, prestress)
        return replace(self, prestress=prestress, elements=elements)

    def from_rest(self, u: FloatArray) -> FloatArray:
        """Return a displacement relative to the prestretch, given one relative to the image."""
        return u + (self.prepared.mesh.nodes_mm - self.prestress.rest_mm)

    def held_at(self, u: FloatArray, stage: Stage) -> FloatArray:
        """Return a displacement with the clamped limbus at its position in the stage."""
        if not self.prepared.clamped:
            return u
        u = u.copy()
        u[self.prepared.limbus.nodes] = self.prepared.limbus.motion(self.load, stage.motion)
        return u

    def residual(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float]:
        """Return the out-of-balance force of the unknowns and the smallest J."""
        return self._evaluate(u, stage, NOTHING)

    def linearise(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float, Factors]:
        """Return the out-of-balance force, the smallest J and the factored tangent."""
        residual, min_j, values = self.tangent(u, stage)
        return residual, min_j, factorise(self.prepared.envelope, values, self.prepared.unknowns)

    def tangent(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float, FloatArray]:
        """Return the out-of-balance force, the smallest J and the entries of the tangent."""
        values = new_values(self.prepared.envelope)
        residual, min_j = self._evaluate(u, stage, values)
        return residual, min_j, values

    def _evaluate(
        self, u: FloatArray, stage: Stage, values: FloatArray
    ) -> tuple[FloatArray, float]:
        prepared = self.prepared
        equations, envelope = prepared.equations, prepared.envelope
        residual = np.zeros(prepared.unknowns)
        inside = self.from_rest(u)
        min_j = assemble(
            inside, self.elements, self.law, prepared.kind, equations, residual, envelope, values
        )
        x = prepared.mesh.nodes_mm + u
        for points, pressure in ((prepared.posterior, stage.iop_mpa), (self.jet, stage.jet_mpa)):
            if pressure != 0:
                add_pressure(x, points, pressure, equations, residual, envelope, values)
        if prepared.model.limbus_mpa_per_mm is not None:
            self._add_support(x, stage, residual, values)
        return residual, min_j

    def _add_support(
        self, x: FloatArray, stage: Stage, residual: FloatArray, values: FloatArray
    ) -> None:
        """Add the force and the stiffness of an elastic limbus."""
        prepared, limbus = self.prepared, self.prepared.limbus
        assert prepared.model.limbus_mpa_per_mm is not None
        stiffness = prepared.model.limbus_mpa_per_mm * limbus.mass
        anchor = self.prestress.support_mm + limbus.motion(self.load, stage.motion)
        force = stiffness @ (x[limbus.nodes] - anchor)
        rows, columns = np.nonzero(stiffness)
        for component in range(2):
            unknowns = prepared.equations[limbus.nodes, component]
            free = unknowns >= 0
            residual[unknowns[free]] += force[free, component]
            if len(values):
                i, j = unknowns[rows], unknowns[columns]
                both = (i >= 0) & (j >= 0)
                entries = prepared.envelope.row_starts[i[both]] + j[both]
                values[entries] += stiffness[rows[both], columns[both]]


def system_of(prepared: PreparedMesh, constants: CorneaConstants, load: CorneaLoad) -> System:
    """Return a cornea that is stress-free in the image.

    Raises
    ------
    InputError
        If the jet extends beyond the cornea.
    """
    mesh = prepared.mesh
    jet = jet_points(mesh.nodes_mm, mesh.anterior, load, prepared.axisymmetric)
    shape = prepared.geometry.weights.shape
    prestretch = np.zeros((*shape, 4))
    prestretch[..., [0, 3]] = 1.0
    prestress = Prestress(
        initial_stress=np.zeros((*shape, 4)),
        prestretch=prestretch,
        out_of_plane=np.ones(shape),
        rest_mm=mesh.nodes_mm,
        support_mm=prepared.limbus.position_mm,
    )
    elements = _elements(prepared, prestress)
    return System(prepared, constants.law(), load, jet, prestress, elements)


def _elements(prepared: PreparedMesh, prestress: Prestress) -> Elements:
    """Return the triangles relative to their stress-free state."""
    method = prepared.model.prestress
    geometry = prepared.geometry
    if method == "inverse" and prestress.rest_mm is not prepared.mesh.nodes_mm:
        geometry = point_geometry(
            prepared.mesh,
            prestress.rest_mm,
            prepared.model.quadrature_points,
            prepared.axisymmetric,
        )
    gradients, hoop, weights = geometry
    stretch = prestress.out_of_plane
    if method == "mulf":
        F0 = prestress.prestretch.reshape(*weights.shape, 2, 2)
        area = F0[..., 0, 0] * F0[..., 1, 1] - F0[..., 0, 1] * F0[..., 1, 0]
        gradients = np.swapaxes(F0, -1, -2) @ gradients
        hoop = hoop * stretch[..., None]
        weights = weights / (area * stretch)
    elif method == "inverse":
        weights = weights / stretch
    return Elements(
        prepared.mesh.triangles,
        gradients,
        hoop,
        weights,
        prestress.prestretch,
        stretch if method == "mulf" else np.ones_like(stretch),
        prestress.initial_stress,
        prepared.stiffness,
    )


MAX_NEWTON_ITERATIONS = 25
MAX_HALVINGS = 8
# Longest displacement of any node per iteration; beyond it the tangent is not valid.
LONGEST_STEP_MM = 0.2
# The tangent is renewed unless a correction is shorter than the last one by this factor.
KEEP_FACTORS_BELOW = 0.15


@dataclass(frozen=True, eq=False)
class Newton:
    """The result of Newton's method; `reason` is empty if it converged.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        Displacement from the image in mm.
    reason : str
    iterations, factorisations : int
    min_j : float
    factors : Factors or None
        The latest ones, of a tangent near u.
    """

    u: FloatArray
    reason: str
    iterations: int
    factorisations: int
    min_j: float
    factors: Factors | None


def solve_stage(
    system: System, stage: Stage, start: FloatArray, factors: Factors | None = None
) -> Newton:
    """Find the equilibrium near `start`, (n, 2) in mm, under a stage of the load.

    Given `factors`, of a tangent near the start, are tried first.
    """
    tolerance = system.prepared.model.tolerance_mm
    u = system.held_at(start, stage)
    residual, min_j = system.residual(u, stage)
    factorised, fresh, length = 0, False, np.inf
    step: FloatArray | None = None if factors is None else -factors.solve(residual)
    for iteration in range(1, MAX_NEWTON_ITERATIONS + 1):
        if not (min_j > 0 and np.isfinite(residual).all()):
            return Newton(u, "an element is squeezed flat", iteration, factorised, min_j, factors)
        if step is None or factors is None:
            residual, min_j, factors = system.linearise(u, stage)
            factorised, fresh = factorised + 1, True
            if factors.singular:
                return Newton(u, "the tangent is singular", iteration, factorised, min_j, None)
            step = -factors.solve(residual)
        length = float(np.abs(step).max())
        if length <= tolerance:
            u = u + system.prepared.spread(step)
            return Newton(u, "", iteration, factorised, min_j, factors)
        part, trial = _line_search(system, stage, u, step, factors)
        if trial is None and not fresh:
            step = None
            continue
        if trial is None:
            reason = f"no step lowers the error of {1e3 * length:.3g} um"
            return Newton(u, reason, iteration, factorised, min_j, factors)
        u, residual, min_j, following = trial
        fresh = False
        contraction = float(np.abs(following).max()) / length
        if part == 1 and contraction < KEEP_FACTORS_BELOW:
            if contraction * length <= tolerance:
                u = u + system.prepared.spread(following)
                return Newton(u, "", iteration, factorised, min_j, factors)
            step = following
        else:
            step = None
    reason = f"{MAX_NEWTON_ITERATIONS} Newton iterations left an error of {1e3 * length:.3g} um"
    return Newton(u, reason, MAX_NEWTON_ITERATIONS, factorised, min_j, factors)


_Trial = tuple[FloatArray, FloatArray, float, FloatArray]


def _line_search(
    system: System, stage: Stage, u: FloatArray, step: FloatArray, factors: Factors
) -> tuple[float, _Trial | None]:
    """Shorten a step until the next correction is shorter than the step.

    Returns the accepted fraction of the step, and the displacement, residual, smallest J and
    correction there; None if no fraction is acceptable.
    """
    length = float(np.linalg.norm(step))
    part = min(1.0, LONGEST_STEP_MM / float(np.abs(step).max()))
    direction = system.prepared.spread(step)
    for _ in range(MAX_HALVINGS):
        there = u + part * direction
        residual, min_j = system.residual(there, stage)
        if min_j > 0 and np.isfinite(residual).all():
            following = -factors.solve(residual)
            if np.linalg.norm(following) <= (1 - part / 4) * length:
                return part, (there, residual, min_j, following)
        part /= 2
    return 0.0, None


# Fractions of the way: the path ends if a smaller step would be needed.
SMALLEST_LOAD_STEP = 1e-3
LOAD_STEP_GROWTH = 1.5


@dataclass(frozen=True, eq=False)
class LoadPath:
    """The result of following an equilibrium.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        The last displacement in equilibrium, from the image, in mm.
    reason : str
        Why the path ended early; empty if it reached the requested stage.
    fraction : float
        Completed fraction of the way.
    steps, cuts, iterations, factorisations : int
    min_j : float
    factors : Factors or None
    """

    u: FloatArray
    reason: str
    fraction: float
    steps: int
    cuts: int
    iterations: int
    factorisations: int
    min_j: float
    factors: Factors | None


def follow(
    system: System, start: FloatArray, begin: Stage, end: Stage, first_step: float
) -> LoadPath:
    """Follow an equilibrium from stage `begin` to stage `end`.

    Each step starts from the parabola, or the line, through the previous equilibria.
    """
    past: list[tuple[float, FloatArray]] = [(0.0, start)]
    results: list[Newton] = []
    step, min_j, factors = first_step, np.inf, None
    while past[-1][0] < 1:
        fraction = min(1.0, past[-1][0] + step)
        if 1 - fraction < SMALLEST_LOAD_STEP:
            fraction = 1.0
        guess = _extrapolate(past, fraction)
        result = solve_stage(system, begin.towards(end, fraction), guess, factors)
        results.append(result)
        if result.reason:
            factors, step = None, (fraction - past[-1][0]) / 2
            if step < SMALLEST_LOAD_STEP:
                break
        else:
            past = [*past[-2:], (fraction, result.u)]
            factors, min_j = result.factors, result.min_j
            step *= LOAD_STEP_GROWTH
    cuts = sum(bool(r.reason) for r in results)
    return LoadPath(
        u=past[-1][1],
        reason=result.reason,
        fraction=past[-1][0],
        steps=len(results) - cuts,
        cuts=cuts,
        iterations=sum(r.iterations for r in results),
        factorisations=sum(r.factorisations for r in results),
        min_j=min_j,
        factors=result.factors,
    )


def _extrapolate(past: list[tuple[float, FloatArray]], fraction: float) -> FloatArray:
    """Return the polynomial through the past equilibria at a fraction of the way."""
    guess = np.zeros_like(past[-1][1])
    for i, (here, u) in enumerate(past):
        weight = 1.0
        for j, (there, _) in enumerate(past):
            if i != j:
                weight *= (fraction - there) / (here - there)
        guess += weight * u
    return guess

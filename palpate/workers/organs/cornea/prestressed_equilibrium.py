r"""Equilibrium of an imaged cornea with the intraocular pressure, then a jet; its derivatives.

==========  =========================================================================
additive    The thesis' steps a to d: (a) the pressure acts on the section in the image,
            taken as undeformed; (b) a simulation gives the stress; (c) that stress is an
            initial stress, S = S(F) + S_0, of the same section under the same pressure;
            (d) these steps are repeated until nothing moves. The material starts at F = 1 each
            time, so what the pre-stretch stiffens is lost.
mulf        Modified updated Lagrangian formulation: not the stress but the deformation
            gradient is carried, F_0 <- F F_0 (Gee, Foerster and Wall 2010).
inverse     The section without pressure is sought that the pressure deforms into the
            image, X <- X - (x(X) - x_image) (Sellier 2011).
none        The section in the image is free of stress and the pressure deforms it.
==========  =========================================================================

In plane stress the section in the image is one unit thick everywhere; with mulf and
inverse it is thicker or thinner without pressure. An elastic support of the limbus keeps its
force from one iteration to the next, as the cornea keeps its stress.

A derivative takes one linear solve for each parameter. At an equilibrium the out-of-balance force
R(u, s; phi) vanishes, with the state s from the prestress iteration. Its iterates are

.. math:: R(u_k, s_k; \phi) = 0, \quad s_{k+1} = g(u_k, s_k; \phi),

and each is differentiated in turn with its own tangent K,

.. math:: K_k \, du_k = - \partial_\phi R - \partial_s R \, ds_k, \quad
          ds_{k+1} = \partial_u g \, du_k + \partial_s g \, ds_k + \partial_\phi g,

then the equilibrium under the jet in the same way. This is the derivative of the result of
`solve_prepared`, including the iteration. The right-hand sides are central differences of forces
and states at the same displacement, with a step of `DERIVATIVE_STEP` times the parameter's scale,
which need no solve; compared with differences of whole solutions they are accurate to 1e-6. Beside
the parameters of a candidate, the depth of the posterior surface can be changed (`thickened`).

If the edge of a uniform jet is exactly on a node, the derivative with respect to its centre or
width is discontinuous, and the mean of both sides is returned.

References: M. A. Lago, PhD thesis, 2014, section 5.3. M. W. Gee, C. Foerster and
W. A. Wall, Int. J. Numer. Meth. Biomed. Engng 26 (2010) 52-72. M. Sellier, Comput. Mech.
48 (2011) 667-672.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.boundary_value_problem import SQUEEZED_J
from palpate.workers.organs.cornea.cornea_equations import (
    LoadPath,
    Newton,
    Prestress,
    Stage,
    System,
    follow,
    solve_stage,
    system_of,
)
from palpate.workers.organs.cornea.cornea_problem import (
    Candidate,
    PreparedMesh,
    changed,
    prepare,
    scale_of,
)
from palpate.workers.organs.cornea.corneal_model import CorneaConstants, CorneaLoad
from palpate.workers.organs.cornea.corneal_ogden import PLANE_STRESS
from palpate.workers.organs.cornea.envelope_lu import Factors
from palpate.workers.organs.cornea.section_mesh import T6Mesh
from palpate.workers.organs.cornea.t6_elements import deformed_state

MAX_PRESTRESS_ITERATIONS = 40
# The distance from the image must not grow between iterations, with this many exceptions.
MAX_STALLED = 3

NO_LOAD = Stage(0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Iterate:
    """One simulation under the intraocular pressure: its initial state and its displacement."""

    prestress: Prestress
    u: FloatArray


@dataclass(frozen=True, eq=False)
class PrestressedSystem:
    """A cornea in equilibrium with the intraocular pressure, or the reason for failure.

    Parameters
    ----------
    system : System
    u : ndarray, shape (n, 2)
        Displacement from the image: zero to the tolerance, except with the method "none".
    reason : str
    iterates : tuple of Iterate
        The iterations, in order.
    newton_iterations, factorisations, load_steps, cuts : int
    """

    system: System
    u: FloatArray
    reason: str
    iterates: tuple[Iterate, ...]
    newton_iterations: int
    factorisations: int
    load_steps: int
    cuts: int


def prestressed(system: System) -> PrestressedSystem:
    """Find the state in which the intraocular pressure does not move a cornea."""
    stage = system.image_stage
    zero = np.zeros_like(system.prepared.mesh.nodes_mm)
    if stage.iop_mpa == 0:
        return PrestressedSystem(system, zero, "", (), 0, 0, 0, 0)
    path = follow(system, zero, NO_LOAD, stage, first_step=1.0)
    if path.reason:
        return _ended(system, path, f"under the pressure of the eye {path.reason}")
    if system.prepared.model.prestress == "none":
        return _ended(system, path, "")
    return _iterate(system, path)


def advance(system: System, u: FloatArray) -> Prestress:
    """Return the next initial state, given the displacement u from the current one."""
    prepared, prestress = system.prepared, system.prestress
    method = prepared.model.prestress
    inside = system.from_rest(u)
    gradient, stretch, stress = deformed_state(inside, system.elements, system.law, prepared.kind)
    support = prestress.support_mm - u[prepared.limbus.nodes]
    if method == "additive":
        return prestress._replace(initial_stress=stress, support_mm=support)
    if method == "mulf":
        return prestress._replace(prestretch=gradient, out_of_plane=stretch, support_mm=support)
    thickness = stretch if prepared.kind == PLANE_STRESS else np.ones_like(stretch)
    return prestress._replace(
        rest_mm=prestress.rest_mm - u, out_of_plane=thickness, support_mm=support
    )


def _iterate(system: System, path: LoadPath) -> PrestressedSystem:
    """Repeat the simulation until the cornea matches the image."""
    model, stage = system.prepared.model, system.image_stage
    u, factors = path.u, path.factors
    iterates: list[Iterate] = []
    newton, factorised = path.iterations, path.factorisations
    distance, stalled, reason = np.inf, 0, ""
    while True:
        iterates.append(Iterate(system.prestress, u))
        last, distance = distance, float(np.abs(u).max())
        if distance < model.prestress_tolerance_mm:
            break
        stalled += distance > 0.9 * last
        if stalled > MAX_STALLED or len(iterates) == MAX_PRESTRESS_ITERATIONS:
            reason = (
                f"the prestress did not converge: {len(iterates)} iterations left the cornea "
                f"{1e3 * distance:.3g} um from the image"
            )
            break
        try:
            system = system.with_prestress(advance(system, u))
        except InputError as error:
            reason = f"the prestress did not converge: without pressure {error}"
            break
        keep = factors if len(iterates) > 1 else None
        result: Newton | LoadPath = solve_stage(system, stage, np.zeros_like(u), keep)
        newton += result.iterations
        factorised += result.factorisations
        if result.reason and model.prestress == "inverse":
            # The image is far from the result of the section without pressure: approach it.
            rest = system.prestress.rest_mm - system.prepared.mesh.nodes_mm
            result = follow(system, rest, NO_LOAD, stage, first_step=1.0)
            newton += result.iterations
            factorised += result.factorisations
        if result.reason:
            reason = f"the prestress did not converge: {result.reason}"
            break
        u, factors = result.u, result.factors
    return PrestressedSystem(
        system, u, reason, tuple(iterates), newton, factorised, path.steps, path.cuts
    )


def _ended(system: System, path: LoadPath, reason: str) -> PrestressedSystem:
    return PrestressedSystem(
        system,
        path.u,
        reason,
        (Iterate(system.prestress, path.u),),
        path.iterations,
        path.factorisations,
        path.steps,
        path.cuts,
    )


# Fraction of the jet in the first step.
FIRST_LOAD_STEP = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class CorneaSolution:
    """The deformation of a cornea, and how it was found.

    Divergence is an ordinary outcome with its reason; the displacement is then the last one in
    equilibrium.

    Parameters
    ----------
    displacement_mm : ndarray, shape (n, 2)
        Relative to the image of the undeformed cornea.
    converged : bool
    reason : str
        Why it did not converge; empty if it did.
    apex_displacement_um : float
        Displacement of the highest node of the anterior surface, positive into the eye.
    newton_iterations, factorisations : int
        Totals of prestress and jet.
    prestress_iterations : int
    load_steps, cuts : int
        Load steps in equilibrium, and steps that had to be halved.
    jet_fraction : float
        Fraction of the jet in equilibrium; 1 if it converged.
    min_j : float
        Smallest volume ratio.
    stable : bool
        Whether the tangent at the end has no negative pivot. A snap-through would leave an
        unstable equilibrium.
    """

    displacement_mm: FloatArray
    converged: bool
    reason: str
    apex_displacement_um: float
    newton_iterations: int
    factorisations: int
    prestress_iterations: int
    load_steps: int
    cuts: int
    jet_fraction: float
    min_j: float
    stable: bool


def solve_prepared(
    prepared: PreparedMesh, constants: CorneaConstants, load: CorneaLoad
) -> CorneaSolution:
    """Solve one candidate on a prepared mesh.

    Raises
    ------
    InputError
        If the jet extends beyond the cornea.
    """
    return equilibrium(prepared, constants, load).solution


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """A solution with the equations that it solves."""

    prestressed: PrestressedSystem
    solution: CorneaSolution


def equilibrium(
    prepared: PreparedMesh, constants: CorneaConstants, load: CorneaLoad
) -> Equilibrium:
    """Solve one candidate and keep the data for its derivatives."""
    rest = prestressed(system_of(prepared, constants, load))
    if rest.reason:
        return Equilibrium(rest, _solution(rest, None, False))
    system = rest.system
    path = follow(system, rest.u, system.image_stage, system.jet_stage, FIRST_LOAD_STEP)
    stable = False
    if not path.reason:
        _, _, factors = system.linearise(path.u, system.jet_stage)
        stable = not factors.singular and factors.negative_pivots == 0
    return Equilibrium(rest, _solution(rest, path, stable))


def _solution(rest: PrestressedSystem, path: LoadPath | None, stable: bool) -> CorneaSolution:
    u = rest.u if path is None else path.u
    reason = rest.reason
    if path is not None and path.reason:
        reason = f"at {100 * path.fraction:.1f} % of the jet {path.reason}"
    return CorneaSolution(
        displacement_mm=u,
        converged=not reason,
        reason=reason,
        apex_displacement_um=-1e3 * float(u[rest.system.prepared.apex, 1]),
        newton_iterations=rest.newton_iterations + (path.iterations if path else 0),
        factorisations=rest.factorisations + (path.factorisations if path else 0),
        prestress_iterations=len(rest.iterates),
        load_steps=rest.load_steps + (path.steps if path else 0),
        cuts=rest.cuts + (path.cuts if path else 0),
        jet_fraction=path.fraction if path else 0.0,
        min_j=path.min_j if path else float(np.nan),
        stable=stable,
    )


@dataclass(frozen=True, eq=False)
class CorneaOutcome:
    """A solution with the interfaces `Solution` and `Outcome` of `workers.organs.organ_protocol`.

    Parameters
    ----------
    solution : CorneaSolution
    """

    solution: CorneaSolution

    @property
    def displacement_mm(self) -> FloatArray:
        """Return the displacement of the nodes, shape (n, 2)."""
        return self.solution.displacement_mm

    @property
    def outcome(self) -> "CorneaOutcome":
        """Return this object, which is also the outcome."""
        return self

    @property
    def converged(self) -> bool:
        """Return True if the displacement is in equilibrium with the full load."""
        return self.solution.converged

    @property
    def reason(self) -> str:
        """Return the reason for divergence; empty if converged."""
        return self.solution.reason

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome as plain values, units in their names."""
        s = self.solution
        return {
            "converged": s.converged,
            "apex_displacement_um": s.apex_displacement_um,
            "jet_fraction": s.jet_fraction,
            "min_j": s.min_j if np.isfinite(s.min_j) else None,
            "squeezed": bool(s.converged and s.min_j < SQUEEZED_J),
            "stable": s.stable,
            "load_steps": s.load_steps,
            "cuts": s.cuts,
            "prestress_iterations": s.prestress_iterations,
            "newton_iterations": [s.newton_iterations],
            "factorisations": s.factorisations,
        }


# Relative to the scale of a parameter: truncation and rounding errors are then about 1e-9.
DERIVATIVE_STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class CandidateChange:
    """Two candidates on either side of the current one, `step` from it in a parameter.

    Their meshes may differ, but not in the triangles: an error of the thickness, for instance,
    moves the nodes.
    """

    plus: Candidate
    minus: Candidate
    step: float


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """A solution and its derivatives.

    Parameters
    ----------
    solution : CorneaSolution
    derivatives : ndarray, shape (parameters, n, 2)
        Derivatives of the displacement, in mm per unit of each parameter; nan if the solution
        did not converge.
    """

    solution: CorneaSolution
    derivatives: FloatArray


def change_of(candidate: Candidate, name: str) -> CandidateChange:
    """Return a change in the named parameter; see `candidate.parameter_names`.

    Raises
    ------
    InputError
        If the parameter is unknown, or is a pressure of zero.
    """
    step = DERIVATIVE_STEP * scale_of(candidate, name)
    if name in ("iop_mpa", "jet_pressure_mpa") and getattr(candidate.load, name) == 0:
        raise InputError(f"The derivative with respect to {name} needs a non-zero pressure.")
    return CandidateChange(changed(candidate, name, step), changed(candidate, name, -step), step)


def sensitivity(
    candidate: Candidate, changes: Sequence[CandidateChange | str], at: Equilibrium | None = None
) -> Sensitivity:
    """Solve a cornea and differentiate its displacement.

    Parameters
    ----------
    candidate : Candidate
    changes : sequence of Change or str
        Changes, or names of parameters.
    at : Equilibrium, optional
        Equilibrium of the candidate, if it is already solved.

    Raises
    ------
    InputError
        As for `change_of` and `solve_prepared`.
    """
    pairs = [change_of(candidate, c) if isinstance(c, str) else c for c in changes]
    if at is None:
        at = equilibrium(candidate.prepared, candidate.constants, candidate.load)
    solution, rest = at.solution, at.prestressed
    u = solution.displacement_mm
    if not solution.converged:
        return Sensitivity(solution, np.full((len(pairs), *u.shape), np.nan))
    tracks = [_Track(pair, rest.system) for pair in pairs]
    for k, iterate in enumerate(rest.iterates):
        if k > 0:
            for track in tracks:
                track.advance(rest.iterates[k - 1])
        system = rest.system.with_prestress(iterate.prestress)
        _, _, factors = system.linearise(iterate.u, system.image_stage)
        for track in tracks:
            track.differentiate(iterate, factors, under_jet=False)
    end = Iterate(rest.system.prestress, u)
    _, _, factors = rest.system.linearise(u, rest.system.jet_stage)
    for track in tracks:
        track.differentiate(end, factors, under_jet=True)
    return Sensitivity(solution, np.array([t.du for t in tracks]).reshape(len(pairs), *u.shape))


class _Track:
    """Derivative with respect to one parameter, propagated through the iterates.

    Parameters
    ----------
    change : Change
    system : System
        The current system.

    Attributes
    ----------
    du : ndarray, shape (n, 2)
        Derivative of the displacement.
    """

    def __init__(self, change: CandidateChange, system: System) -> None:
        self._step = change.step
        self._plus, self._minus = (
            system_of(c.prepared, c.constants, c.load) for c in (change.plus, change.minus)
        )
        pairs = zip(self._plus.prestress, self._minus.prestress, strict=True)
        self._ds = Prestress(*((a - b) / (2 * change.step) for a, b in pairs))
        self.du = np.zeros_like(system.prepared.mesh.nodes_mm)

    def differentiate(self, iterate: Iterate, factors: Factors, under_jet: bool) -> None:
        """Set the derivative of the displacement of an iterate, or of the end under the jet."""
        plus, minus = self._either_side(iterate.prestress)
        stages = [s.jet_stage if under_jet else s.image_stage for s in (plus, minus)]
        carried = self._carried(stages[0].motion)
        residuals = []
        for system, stage, h in zip((plus, minus), stages, (self._step, -self._step), strict=True):
            u = system.held_at(iterate.u + h * carried, stage)
            residuals.append(system.residual(u, stage)[0])
        change = (residuals[0] - residuals[1]) / (2 * self._step)
        self.du = carried + plus.prepared.spread(-factors.solve(change))

    def advance(self, iterate: Iterate) -> None:
        """Propagate the derivative to the state after an iterate."""
        h = self._step
        plus, minus = self._either_side(iterate.prestress)
        pairs = zip(
            advance(plus, iterate.u + h * self.du),
            advance(minus, iterate.u - h * self.du),
            strict=True,
        )
        self._ds = Prestress(*((a - b) / (2 * h) for a, b in pairs))

    def _carried(self, motion: float) -> FloatArray:
        """Return the derivative of the eye's motion, if the limbus is clamped to it.

        It is returned for all nodes: as they move as a rigid body, the triangles at the limbus
        are not strained by the difference.
        """
        if not self._plus.prepared.clamped:
            return np.zeros_like(self.du)
        plus, minus = (
            s.prepared.limbus.motion(s.load, motion, s.prepared.mesh.nodes_mm)
            for s in (self._plus, self._minus)
        )
        return (plus - minus) / (2 * self._step)

    def _either_side(self, prestress: Prestress) -> tuple[System, System]:
        """Return the systems with the parameter and the state on either side."""
        pairs = [(s, self._step * d) for s, d in zip(prestress, self._ds, strict=True)]
        plus = self._plus.with_prestress(Prestress(*(s + d for s, d in pairs)))
        minus = self._minus.with_prestress(Prestress(*(s - d for s, d in pairs)))
        return plus, minus


# Difference step in millimetres.
THICKNESS_STEP_MM = 1e-5


def thickness_change(candidate: Candidate) -> CandidateChange:
    """Return the change to a uniformly thicker cornea, per mm."""
    plus, minus = (thickened(candidate, sign * THICKNESS_STEP_MM) for sign in (1, -1))
    return CandidateChange(plus, minus, THICKNESS_STEP_MM)


def thickened(candidate: Candidate, by_mm: float, sideways: float = 0.0) -> Candidate:
    """Return a candidate with a deeper posterior surface.

    Parameters
    ----------
    candidate : Candidate
    by_mm : float
        Distance along the normal; negative makes the cornea thinner.
    sideways : float
        From -1 to 1: 0 moves the whole surface alike, 1 the middle but not the edges, like a
        distortion that grows towards the middle of an image.
    """
    prepared = candidate.prepared
    nodes = deeper(prepared.mesh, by_mm, sideways)
    mesh = replace(prepared.mesh, nodes_mm=nodes)
    return replace(candidate, prepared=prepare(mesh, prepared.model))


def deeper(mesh: T6Mesh, by_mm: float, sideways: float = 0.0) -> FloatArray:
    """Return the nodes of a mesh with a moved posterior surface; those in between follow."""
    x = mesh.nodes_mm
    above, normal = _distance_and_normal(x, x[mesh.anterior])
    below, _ = _distance_and_normal(x, x[mesh.posterior])
    depth = above / (above + below)
    middle, half = (x[:, 0].max() + x[:, 0].min()) / 2, np.ptp(x[:, 0]) / 2
    bow = 1.0 - sideways * ((x[:, 0] - middle) / half) ** 2
    return np.asarray(x - by_mm * (depth * bow)[:, None] * normal)


def _distance_and_normal(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances of points from a polyline, and its outward normals there."""
    start, along = line[:-1], np.diff(line, axis=0)
    arm = points[:, None] - start
    part = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    distance = np.linalg.norm(arm - part[..., None] * along, axis=-1)
    nearest = distance.argmin(axis=1)
    tangent = along[nearest] / np.linalg.norm(along[nearest], axis=1, keepdims=True)
    return distance.min(axis=1), np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)

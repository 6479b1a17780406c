r"""Equilibrium of an imaged cornea with the intraocular pressure.

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

References: M. A. Lago, PhD thesis, 2014, section 5.3. M. W. Gee, C. Foerster and
W. A. Wall, Int. J. Numer. Meth. Biomed. Engng 26 (2010) 52-72. M. Sellier, Comput. Mech.
48 (2011) 667-672.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.material.ogden_stress import PLANE_STRESS
from palpate.workers.organs.cornea.solver.load_stepping import Path, follow
from palpate.workers.organs.cornea.solver.newton import Newton, solve_stage
from palpate.workers.organs.cornea.solver.system import Prestress, Stage, System
from palpate.workers.organs.cornea.solver.t6_assembly import deformed_state

MAX_ITERATIONS = 40
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


def _iterate(system: System, path: Path) -> PrestressedSystem:
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
        if stalled > MAX_STALLED or len(iterates) == MAX_ITERATIONS:
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
        result: Newton | Path = solve_stage(system, stage, np.zeros_like(u), keep)
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


def _ended(system: System, path: Path, reason: str) -> PrestressedSystem:
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

"""Solution of a cornea under the intraocular pressure and an air jet."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.material.constants import CorneaConstants
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.solver.load_stepping import Path, follow
from palpate.workers.organs.cornea.solver.prepared_mesh import PreparedMesh
from palpate.workers.organs.cornea.solver.prestress import PrestressedSystem, prestressed
from palpate.workers.organs.cornea.solver.system import system_of

# Fraction of the jet in the first step.
FIRST_STEP = 1.0


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
    path = follow(system, rest.u, system.image_stage, system.jet_stage, FIRST_STEP)
    stable = False
    if not path.reason:
        _, _, factors = system.linearise(path.u, system.jet_stage)
        stable = not factors.singular and factors.negative_pivots == 0
    return Equilibrium(rest, _solution(rest, path, stable))


def _solution(rest: PrestressedSystem, path: Path | None, stable: bool) -> CorneaSolution:
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

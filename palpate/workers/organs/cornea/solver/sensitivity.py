r"""Derivatives of a deformed cornea with respect to parameters: one linear solve each.

At an equilibrium the out-of-balance force R(u, s; phi) vanishes, with the state s from the
prestress iteration. Its iterates are

.. math:: R(u_k, s_k; \phi) = 0, \quad s_{k+1} = g(u_k, s_k; \phi),

and each is differentiated in turn with its own tangent K,

.. math:: K_k \, du_k = - \partial_\phi R - \partial_s R \, ds_k, \quad
          ds_{k+1} = \partial_u g \, du_k + \partial_s g \, ds_k + \partial_\phi g,

then the equilibrium under the jet in the same way. This is the derivative of the result of
`solve`, including the iteration. The right-hand sides are central differences of forces and
states at the same displacement, with a step of `STEP` times the parameter's scale, which need no
solve; compared with differences of whole solutions they are accurate to 1e-6.

If the edge of a uniform jet is exactly on a node, the derivative with respect to its centre or
width is discontinuous, and the mean of both sides is returned.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.solver.candidate import Candidate, changed, scale_of
from palpate.workers.organs.cornea.solver.envelope_lu import Factors
from palpate.workers.organs.cornea.solver.prestress import Iterate, advance
from palpate.workers.organs.cornea.solver.solve import CorneaSolution, Equilibrium, equilibrium
from palpate.workers.organs.cornea.solver.system import Prestress, System, system_of

# Relative to the scale of a parameter: truncation and rounding errors are then about 1e-9.
STEP = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Change:
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


def change_of(candidate: Candidate, name: str) -> Change:
    """Return a change in the named parameter; see `candidate.parameter_names`.

    Raises
    ------
    InputError
        If the parameter is unknown, or is a pressure of zero.
    """
    step = STEP * scale_of(candidate, name)
    if name in ("iop_mpa", "jet_pressure_mpa") and getattr(candidate.load, name) == 0:
        raise InputError(f"The derivative with respect to {name} needs a non-zero pressure.")
    return Change(changed(candidate, name, step), changed(candidate, name, -step), step)


def sensitivity(
    candidate: Candidate, changes: Sequence[Change | str], at: Equilibrium | None = None
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

    def __init__(self, change: Change, system: System) -> None:
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

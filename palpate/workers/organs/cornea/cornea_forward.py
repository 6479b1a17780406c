"""The cornea as the forward problem of a diagnosis, and its strain and stress."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.boundary_value_problem import Change
from palpate.workers.organs.cornea.cornea_problem import Candidate, prepare
from palpate.workers.organs.cornea.corneal_model import CorneaModel
from palpate.workers.organs.cornea.prestressed_equilibrium import (
    CandidateChange,
    CorneaSolution,
    Equilibrium,
    equilibrium,
    sensitivity,
    solve_prepared,
)
from palpate.workers.organs.cornea.t6_elements import deformed_state


def deformation_and_stress(solved: Equilibrium) -> tuple[FloatArray, FloatArray]:
    """Return the deformation gradient and the Cauchy stress in MPa.

    Both have the shape (m, q, 3, 3): m triangles, q points in each; the third axis is normal
    to the section. The gradient is relative to the configuration of the prestress.
    """
    u, system = solved.solution.displacement_mm, solved.prestressed.system
    plane, third, stress = deformed_state(
        system.from_rest(u), system.elements, system.law, system.prepared.kind
    )
    F = np.zeros((*third.shape, 3, 3))
    F[..., :2, :2] = plane.reshape(*third.shape, 2, 2)
    F[..., 2, 2] = third
    S = np.zeros_like(F)
    S[..., 0, 0], S[..., 1, 1], S[..., 2, 2] = stress[..., 0], stress[..., 1], stress[..., 3]
    S[..., 0, 1] = S[..., 1, 0] = stress[..., 2]
    cauchy = F @ S @ F.swapaxes(-1, -2) / np.linalg.det(F)[..., None, None]
    return F, cauchy


@dataclass(frozen=True, eq=False)
class CorneaProblem:
    """A candidate, blended with candidates of other model options.

    Parameters
    ----------
    candidate : Candidate
    shares : mapping of (str, str) to float
        By option of the model and its other value, such as ("kind", "plane strain"): weight
        of the displacement with that option, the rest being the candidate's own.
    """

    candidate: Candidate
    shares: dict[tuple[str, str], float] = field(default_factory=dict)


def remodelled(candidate: Candidate, **options: Any) -> Candidate:
    """Return a candidate with other options of its model."""
    prepared = candidate.prepared
    model: CorneaModel = replace(prepared.model, **options)
    return replace(candidate, prepared=prepare(prepared.mesh, model))


@dataclass(frozen=True)
class Ending:
    """The ending of a simulation."""

    converged: bool
    reason: str


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """A displacement with a third component, which is zero."""

    displacement_mm: FloatArray
    outcome: Ending


@dataclass(frozen=True, eq=False)
class CorneaEquilibrium:
    """A problem with its solution, and the equilibrium of its candidate if there is one."""

    problem: CorneaProblem
    solution: PlaneSolution
    of_candidate: Equilibrium | None


class CorneaForward:
    """See `inverse_problem.Forward`. A cornea is always solved from rest."""

    def equilibrium(
        self, model: Any, problem: CorneaProblem, start: Any = None
    ) -> CorneaEquilibrium:
        """Solve a problem; an inconsistent load has no equilibrium."""
        base, at = problem.candidate, None
        try:
            at = equilibrium(base.prepared, base.constants, base.load)
            u, reason = _displacement(problem, at.solution)
        except InputError as error:
            u, reason = np.zeros_like(base.prepared.mesh.nodes_mm), str(error)
        return CorneaEquilibrium(problem, PlaneSolution(_padded(u), Ending(not reason, reason)), at)

    def expecting(self, at: CorneaEquilibrium, moved_mm: FloatArray) -> CorneaEquilibrium:
        """Return the equilibrium unchanged; solutions always start from rest."""
        return at

    def tangents(
        self, at: CorneaEquilibrium, changes: Sequence[Change], tolerance: float = 0.0
    ) -> FloatArray:
        """Return derivatives of the displacement, shape (c, n, 3), in mm per unit.

        They refer to the candidate itself, without shares of other options. The displacement is
        linear in a share, so the derivative is a difference of solutions. The derivative in the
        compliance of a held limbus is one too, because compliance adds unknowns.
        """
        derivatives = np.empty((len(changes), *at.solution.displacement_mm.shape))
        pairs: list[tuple[int, CandidateChange]] = []
        for number, change in enumerate(changes):
            plus: Any = change.plus
            minus: Any = change.minus
            held = {problem.candidate.prepared.clamped for problem in (plus, minus, at.problem)}
            if plus.shares != minus.shares or len(held) > 1:
                ends = [self.equilibrium(None, problem).solution for problem in (plus, minus)]
                apart = ends[0].displacement_mm - ends[1].displacement_mm
                derivatives[number] = apart / change.step
            else:
                half = CandidateChange(plus.candidate, minus.candidate, change.step / 2)
                pairs.append((number, half))
        if pairs:
            differentiated = [pair for _, pair in pairs]
            result = sensitivity(at.problem.candidate, differentiated, at.of_candidate)
            for (number, _), derivative in zip(pairs, result.derivatives, strict=True):
                derivatives[number] = _padded(derivative)
        return derivatives

    def loosened(
        self, problem: CorneaProblem, tolerance_mm: float, friction_steps: int
    ) -> CorneaProblem:
        """Return the problem unchanged, since it is cheap to solve."""
        return problem

    def direction(self, problem: CorneaProblem) -> tuple[float, float, float]:
        """Return the direction of the jet."""
        return 0.0, -1.0, 0.0

    def pressed(self, at: CorneaEquilibrium) -> None:
        """Return None: there are no plates."""


def _displacement(problem: CorneaProblem, solution: CorneaSolution) -> tuple[FloatArray, str]:
    """Return the displacement, (n, 2), and the reason for failure; empty if there is none."""
    base = problem.candidate
    u, reason = solution.displacement_mm, solution.reason
    for (option, value), share in problem.shares.items():
        if reason or share == 0:
            continue
        other = remodelled(base, **{option: value})
        there = solve_prepared(other.prepared, other.constants, other.load)
        reason = there.reason
        u = u + share * (there.displacement_mm - solution.displacement_mm)
    return u, reason


def _padded(u: FloatArray) -> FloatArray:
    return np.concatenate([u, np.zeros((*u.shape[:-1], 1))], axis=-1)

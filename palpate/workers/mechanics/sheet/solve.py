"""Equilibria of a sheet by Newton's method in load steps, and their derivatives."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.sheet.model import SheetModel
from palpate.workers.mechanics.sheet.plane_stress import PlaneStress
from palpate.workers.mechanics.sheet.system import SheetSystem, full

MOST_ITERATIONS = 15
# Bounds of the last Newton step, and of every step, as fractions of the sheet's size.
CONVERGED, LONGEST = 1e-9, 0.3
# A load without an equilibrium is applied in smaller steps, down to this one.
SMALLEST_STEP = 1 / 32


@dataclass(frozen=True, slots=True)
class SheetOutcome:
    """Outcome of a simulation of a sheet.

    Parameters
    ----------
    converged : bool
    reason : str
        Reason for divergence; empty if it converged.
    newton_iterations : int
        Total over all load steps.
    thinnest : float
        Smallest ratio of the thickness to the thickness at rest.
    """

    converged: bool
    reason: str
    newton_iterations: int
    thinnest: float

    def as_dict(self) -> dict[str, Any]:
        """Return the values as a JSON-serialisable dict."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class SheetSolution:
    """Displacement of the nodes, shape (n, 3) in mm, and the outcome."""

    displacement_mm: FloatArray
    outcome: SheetOutcome


class NotFoundError(Exception):
    """Newton's method found no equilibrium."""


@dataclass(frozen=True, eq=False)
class SheetEquilibrium:
    """Sheet at the end of its loading.

    Parameters
    ----------
    system : SheetSystem
    solution : SheetSolution
    response : PlaneStress
        Stress and thickness at the integration points.
    """

    system: SheetSystem
    solution: SheetSolution
    response: PlaneStress

    @property
    def problem(self) -> Problem:
        """Problem that was solved."""
        return self.system.problem

    @property
    def reactions(self) -> FloatArray:
        """Reactions at the held nodes, shape (n, 3), in N."""
        held, _ = self.system.prescribed
        return np.where(held, self._inner_n - self.system.outer_n(self._x), 0.0)

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress of each triangle, shape (m, 3, 3), in MPa."""
        f = self.system.tangents_of_plane(self._x)
        S = full(self.response.stress).reshape(*f.shape[:2], 2, 2)
        pushed = np.einsum("mqia,mqab,mqjb->mqij", f, S, f, optimize=True)
        area = np.linalg.norm(np.cross(f[..., 0], f[..., 1]), axis=-1)
        J = area * self.response.thickness_stretch.reshape(area.shape)
        return np.asarray((pushed / J[..., None, None]).mean(axis=1))

    def tangents(self, changes: Sequence[Change]) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of displacements and reactions for changes in the problem.

        Returns
        -------
        moved, reactions : ndarray, shape (c, n, 3)
            In mm and N per unit of each parameter.

        Raises
        ------
        InputError
            If the simulation did not converge.
        """
        if not self.solution.outcome.converged:
            raise InputError(
                "Only an equilibrium has tangents; this simulation did not converge: "
                f"{self.solution.outcome.reason}."
            )
        held, _ = self.system.prescribed
        moved = np.zeros((len(changes), *self._x.shape))
        forces = np.zeros_like(moved)
        for number, change in enumerate(changes):
            ahead, behind = (self._other(p) for p in (change.plus, change.minus))
            force = (self._force(ahead) - self._force(behind)) / change.step
            u = np.where(held, ahead.prescribed[1] - behind.prescribed[1], 0.0) / change.step
            right = -(force.ravel() + self._stiffness @ u.ravel())
            u.ravel()[self._free] = self._factor.solve(right[self._free])
            moved[number] = u
            whole = force + (self._stiffness @ u.ravel()).reshape(u.shape)
            forces[number] = np.where(held, whole, 0.0)
        return moved, forces

    @cached_property
    def _x(self) -> FloatArray:
        return np.asarray(self.system.model.nodes + self.solution.displacement_mm)

    @cached_property
    def _inner_n(self) -> FloatArray:
        return self.system.inner_n(self._x, self.response)

    @cached_property
    def _stiffness(self) -> Any:
        return self.system.stiffness(self._x, self.response)

    @cached_property
    def _free(self) -> IntArray:
        return np.flatnonzero(~self.system.prescribed[0].ravel()).astype(np.int32)

    @cached_property
    def _factor(self) -> Any:
        return splu(self._stiffness[self._free][:, self._free])

    def _other(self, problem: Problem) -> SheetSystem:
        return self.system if problem is self.problem else SheetSystem(self.system.model, problem)

    def _force(self, system: SheetSystem) -> FloatArray:
        """Return the out-of-balance force here under another problem, shape (n, 3)."""
        own = self.problem
        other = system.problem
        is_same = other.constants == own.constants and other.wall == own.wall
        if is_same and other.variations == own.variations:
            inner = self._inner_n
        else:
            inner = system.inner_n(self._x, system.response(self._x, self.response))
        return np.asarray(inner - system.outer_n(self._x))


def equilibrium(
    model: SheetModel, problem: Problem, start_mm: FloatArray | None = None
) -> SheetEquilibrium:
    """Load a sheet; failure to converge is an ordinary outcome.

    Parameters
    ----------
    model : SheetModel
    problem : Problem
        See `SheetSystem`.
    start_mm : ndarray, shape (n, 3), optional
        Displacement under a similar problem.

    Raises
    ------
    InputError
        If the problem has a feature that sheets do not support.
    """
    system = SheetSystem(model, problem)
    counted: list[int] = []
    reason = ""
    u = np.zeros_like(model.nodes)
    try:
        if start_mm is not None and not system.out_of_plane.any():
            u = _newton(system, start_mm, 1.0, counted)
        else:
            raise NotFoundError
    except NotFoundError:
        u, reason = _in_steps(system, counted)
    response = system.response(model.nodes + u)
    thinnest = float(np.min(response.thickness_stretch))
    outcome = SheetOutcome(not reason, reason, sum(counted), thinnest)
    return SheetEquilibrium(system, SheetSolution(u, outcome), response)


def _in_steps(system: SheetSystem, counted: list[int]) -> tuple[FloatArray, str]:
    """Return the displacement from rest, and a reason for failure; empty if it converged."""
    u, done, step = np.zeros_like(system.model.nodes), 0.0, 1.0
    while done < 1:
        part = min(1.0, done + step)
        try:
            u = _newton(system, _bulged(system, part) if done == 0 else u, part, counted)
        except NotFoundError as error:
            step /= 2
            if step < SMALLEST_STEP:
                return u, f"no equilibrium beyond {done:.3g} of the load: {error}"
        else:
            done, step = part, 1.5 * step
    return u, ""


def _newton(
    system: SheetSystem, start_mm: FloatArray, part: float, counted: list[int]
) -> FloatArray:
    """Return the displacement under a fraction of the load.

    Raises
    ------
    NotFoundError
        If the iterations do not converge.
    """
    held, moved = system.prescribed
    free = np.flatnonzero(~held.ravel())
    u = start_mm.copy()
    # The first step moves held nodes to their prescribed positions, and the others with them.
    gap = np.where(held, part * moved - u, 0.0)
    size = system.model.size_mm
    counted.append(0)
    for _ in range(MOST_ITERATIONS):
        counted[-1] += 1
        x = system.model.nodes + u
        response = system.response(x)
        force = system.inner_n(x, response) - system.outer_n(x, part)
        if not np.isfinite(force).all():
            raise NotFoundError("a triangle has folded over")
        K = system.stiffness(x, response, part)
        right = -(force.ravel() + K @ gap.ravel())
        step = gap.ravel().copy()
        try:
            step[free] = splu(K[free][:, free]).solve(right[free])
        except RuntimeError:
            raise NotFoundError("the sheet is not held, or has lost its stiffness") from None
        longest = float(np.abs(step).max())
        if not np.isfinite(longest):
            raise NotFoundError("the sheet is not held, or has lost its stiffness")
        share = min(1.0, LONGEST * size / longest) if longest > 0 else 1.0
        u = u + share * step.reshape(u.shape)
        gap = (1 - share) * gap
        if longest < CONVERGED * size:
            if system.is_folded(u):
                raise NotFoundError("a triangle has folded over")
            return u
    raise NotFoundError(f"Newton's method did not converge in {MOST_ITERATIONS} iterations")


def _bulged(system: SheetSystem, part: float) -> FloatArray:
    r"""Return the initial displacement for Newton's method, shape (n, 3).

    A flat sheet has no stiffness out of its plane. Under a pressure p it starts with the
    uniform tension :math:`N = 0.43 (E t p^2 a^2)^{1/3}` of a sheet of radius a (H. Hencky,
    Z. Math. Phys. 63 (1915) 311-317).
    """
    model, load = system.model, part * system.out_of_plane
    u = np.zeros_like(model.nodes)
    held = system.prescribed[0][:, 2]
    if not load.any() or held.all():
        return u
    area = float(model.areas.sum())
    stiff = system.constants.young_mpa * model.thickness_mm
    tension = 0.43 * np.cbrt(stiff * (np.abs(load).sum() / area) ** 2 * area / np.pi)
    taut = PlaneStress(
        np.tile([1.0, 1.0, 0.0], (3 * len(model.triangles), 1)),
        np.zeros((3 * len(model.triangles), 3, 3)),
        np.ones(3 * len(model.triangles)),
    )
    # A stress of 1 MPa in a sheet of this thickness is not yet that tension.
    K = system.stiffness(model.nodes, taut, 0.0)
    free = np.flatnonzero(~held)
    along_z = 3 * free + 2
    times = model.thickness_mm / tension
    u[free, 2] = times * splu(K[along_z][:, along_z]).solve(load[free])
    return u

"""Equilibria of a thin sheet in plane stress, in its plane or inflated, and their derivatives.

`SheetSystem` has the forces and the stiffness of a sheet of 6-node triangles of any law under a
problem's loads; Newton's method in load steps balances them with sparse LU.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.boundary_value_problem import (
    GRAVITY_MM_PER_S2,
    Change,
    Constants,
    Problem,
)
from palpate.workers.mechanics.fem.loads_and_regions import nodes_in
from palpate.workers.mechanics.materials.elastic_law import Law, PlaneStress, plane_stress
from palpate.workers.mechanics.materials.polynomial_laws import NeoHookean, Yeoh
from palpate.workers.mechanics.sheet_mesh import INTEGRATION_POINTS, SheetModel
from palpate.workers.mechanics.triangles import shapes

# [i, j, k] is the sign of the permutation: (a x b)_i = CROSS_ijk a_j b_k.
CROSS_PRODUCT = np.zeros((3, 3, 3))
CROSS_PRODUCT[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
CROSS_PRODUCT[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True, eq=False)
class SheetSystem:
    """Sheet with its material and loads.

    Parameters
    ----------
    model : SheetModel
    problem : Problem
        Problem with one tissue. A pressure acts along the normal that points to +z at rest. A
        sheet without forces out of its plane stays in it.

    Raises
    ------
    InputError
        If the problem has a feature that sheets do not support.
    """

    model: SheetModel
    problem: Problem

    def __post_init__(self) -> None:
        p, c = self.problem, self.constants
        refused = {
            "a separate skin": p.membrane,
            "local springs": p.attachments,
            "gravity during imaging": any(p.imaged_gravity_g),
            "fibres": c.fibre_mpa or c.second_fibre_mpa,
            "tissue growth": c.growth != 1,
        }
        unsupported = [name for name, given in refused.items() if given]
        if unsupported:
            raise InputError(
                f"A sheet cannot be simulated with {', '.join(unsupported)}: leave it out."
            )

    @property
    def constants(self) -> Constants:
        """Constants of its material."""
        return next(iter(self.problem.constants.values()))

    @property
    def law(self) -> Law:
        """Law of the change of shape."""
        c = self.constants
        if c.law is not None:
            return c.law
        return Yeoh(c.mu_mpa / 2, c.stiffening * c.mu_mpa) if c.stiffening else NeoHookean(c.mu_mpa)

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of each integration point, shape (m, 3), in mm^3."""
        each = self.model.areas * self.model.thickness_mm / 3
        return np.repeat(each[:, None], 3, axis=1)

    @cached_property
    def stiffnesses(self) -> FloatArray:
        """Volumes times the stiffness factors, shape (m, 3)."""
        log = np.zeros(self.volumes.size)
        for variation in self.problem.variations:
            log += variation.log_factor(self.model.places.reshape(-1, 3))
        return np.asarray(self.volumes * np.exp(log).reshape(self.volumes.shape))

    @cached_property
    def pressure_mpa(self) -> FloatArray:
        """Pressure at the integration points, shape (m, 3)."""
        places = self.model.places.reshape(-1, 3)
        total = np.zeros(len(places))
        for pressure in self.problem.pressures:
            total += pressure.pressure_mpa * pressure.region.contains(places)
        return total.reshape(self.volumes.shape)

    @cached_property
    def dead_n(self) -> FloatArray:
        """Weight and forces of constant direction, shape (n, 3)."""
        model, force = self.model, np.zeros_like(self.model.nodes)
        if any(self.problem.gravity_g):
            mass = self.constants.density_t_per_mm3 * self.volumes.sum()
            even = model.shares(np.ones(len(model.nodes), np.bool_))
            force += np.outer(even, mass * GRAVITY_MM_PER_S2 * np.asarray(self.problem.gravity_g))
        for dead in self.problem.forces:
            inside = nodes_in(dead.region, model.nodes, model.edge_mm)
            force += np.outer(model.shares(inside), dead.force_n)
        return force

    @cached_property
    def bed_n_per_mm(self) -> FloatArray:
        """Stiffness of the elastic bed, shape (n, 3): springs of the wall under the whole sheet."""
        area = self.model.areas.sum() * self.model.shares(np.ones(len(self.model.nodes), np.bool_))
        return np.outer(area, self.problem.wall.spring_mpa_per_mm)

    @cached_property
    def prescribed(self) -> tuple[BoolArray, FloatArray]:
        """Mask of held displacement components, and their values in mm, (n, 3) each."""
        nodes = self.model.nodes
        held, moved = np.zeros(nodes.shape, np.bool_), np.zeros_like(nodes)
        for hold in self.problem.holds:
            inside = nodes_in(hold.region, nodes, self.model.edge_mm)
            there = hold.at(nodes[inside])
            for axis in np.flatnonzero(hold.axes):
                held[inside, axis] = True
                moved[inside, axis] = there[:, axis]
        if not (moved[:, 2].any() or self.out_of_plane.any()):
            held[:, 2] = True
        return held, moved

    @cached_property
    def out_of_plane(self) -> FloatArray:
        """Forces along z on the sheet at rest, shape (n,), in N."""
        return np.asarray(self.outer_n(self.model.nodes)[:, 2])

    def is_folded(self, u: FloatArray) -> bool:
        """Test whether a sheet that stays in its plane is folded over somewhere."""
        f = self.tangents_of_plane(self.model.nodes + u)[..., :2, :]
        return bool(not self.out_of_plane.any() and (np.linalg.det(f) <= 0).any())

    def tangents_of_plane(self, x: FloatArray) -> FloatArray:
        """Return the deformed tangents at the integration points, (m, 3, 3, 2)."""
        corners = x[self.model.triangles]
        return np.einsum("mni,mqna->mqia", corners, self.model.gradients, optimize=True)

    def response(self, x: FloatArray, near: PlaneStress | None = None) -> PlaneStress:
        """Return stress and tangent at all integration points.

        See `plane_stress` for `near`.
        """
        f = self.tangents_of_plane(x).reshape(-1, 3, 2)
        C = np.einsum("qia,qib->qab", f, f)
        return plane_stress(C, self.law, self.constants.kappa_mpa, near)

    def inner_n(self, x: FloatArray, found: PlaneStress) -> FloatArray:
        """Return the internal force on each node, from stretching and the bed, shape (n, 3)."""
        f = self.tangents_of_plane(x)
        S = (
            stress_matrices(found.stress).reshape(*f.shape[:2], 2, 2)
            * self.stiffnesses[..., None, None]
        )
        each = np.einsum("mqia,mqab,mqnb->mni", f, S, self.model.gradients, optimize=True)
        return self._at_nodes(each) + self.bed_n_per_mm * (x - self.model.nodes)

    def outer_n(self, x: FloatArray, part: float = 1.0) -> FloatArray:
        """Return a fraction of the load on each node, shape (n, 3)."""
        if not self.pressure_mpa.any():
            return part * self.dead_n
        f = self.tangents_of_plane(x)
        areas = np.cross(f[..., 0], f[..., 1]) * (self.model.areas / 3)[:, None, None]
        pushed = np.einsum("qn,mq,mqi->mni", shapes(INTEGRATION_POINTS), self.pressure_mpa, areas)
        return part * (self.dead_n + self._at_nodes(pushed))

    def stiffness(self, x: FloatArray, response: PlaneStress, part: float = 1.0) -> csc_array:
        """Return the derivative of the out-of-balance force in `x`, shape (3 n, 3 n)."""
        g, f = self.model.gradients, self.tangents_of_plane(x)
        m = len(g)
        strains = np.zeros((m, 3, 3, 6, 3))  # triangle, point, strain, node, axis
        strains[:, :, :2] = np.einsum("mqia,mqna->mqani", f, g, optimize=True)
        strains[:, :, 2] = np.einsum("mqi,mqn->mqni", f[..., 0], g[..., 1])
        strains[:, :, 2] += np.einsum("mqi,mqn->mqni", f[..., 1], g[..., 0])
        B = strains.reshape(m, 3, 3, 18)
        D = response.tangent.reshape(m, 3, 3, 3) * self.stiffnesses[..., None, None]
        K = np.swapaxes(B.reshape(m, 9, 18), 1, 2) @ (D @ B).reshape(m, 9, 18)
        S = stress_matrices(response.stress).reshape(m, 3, 2, 2) * self.stiffnesses[..., None, None]
        taut = np.einsum("mqna,mqab,mqkb->mnk", g, S, g, optimize=True)
        blocks = K.reshape(m, 6, 3, 6, 3)
        for axis in range(3):
            blocks[:, :, axis, :, axis] += taut
        if self.pressure_mpa.any():
            blocks -= part * self._pushed_tangent(f)
        freedoms = (3 * self.model.triangles[:, :, None] + np.arange(3)).reshape(m, 18)
        rows, columns = np.repeat(freedoms, 18, axis=1), np.tile(freedoms, (1, 18))
        size = self.model.nodes.size
        entries = (K.ravel(), (rows.ravel(), columns.ravel()))
        return csc_array(coo_array(entries, shape=(size, size))) + diags_array(
            self.bed_n_per_mm.ravel(), format="csc"
        )

    def _pushed_tangent(self, f: FloatArray) -> FloatArray:
        """Return the derivative of the pressure's shares, (m, 6, 3, 6, 3)."""
        g = self.model.gradients
        weight = self.pressure_mpa * (self.model.areas / 3)[:, None]
        # (df_1 x f_2 + f_1 x df_2)_i with df_a = sum_k g_ka du_k
        first = np.einsum("ijl,mql,mqk->mqikj", CROSS_PRODUCT, f[..., 1], g[..., 0], optimize=True)
        second = np.einsum("ilj,mql,mqk->mqikj", CROSS_PRODUCT, f[..., 0], g[..., 1], optimize=True)
        N = shapes(INTEGRATION_POINTS)
        return np.einsum("qn,mq,mqikj->mnikj", N, weight, first + second, optimize=True)

    def _at_nodes(self, each: FloatArray) -> FloatArray:
        total = np.zeros_like(self.model.nodes)
        np.add.at(total, self.model.triangles, each)
        return total


def stress_matrices(stress: FloatArray) -> FloatArray:
    """Return S11, S22 and S12 as matrices, (q, 3) to (q, 2, 2)."""
    return stress[:, [[0, 2], [2, 1]]]


MOST_ITERATIONS = 15
# Bounds of the last Newton step, and of every step, as fractions of the sheet's size.
CONVERGED_STEP, LONGEST_STEP = 1e-9, 0.3
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


class NoSheetEquilibriumError(Exception):
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
        S = stress_matrices(self.response.stress).reshape(*f.shape[:2], 2, 2)
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
            raise NoSheetEquilibriumError
    except NoSheetEquilibriumError:
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
        except NoSheetEquilibriumError as error:
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
            raise NoSheetEquilibriumError("a triangle has folded over")
        K = system.stiffness(x, response, part)
        right = -(force.ravel() + K @ gap.ravel())
        step = gap.ravel().copy()
        try:
            step[free] = splu(K[free][:, free]).solve(right[free])
        except RuntimeError:
            raise NoSheetEquilibriumError(
                "the sheet is not held, or has lost its stiffness"
            ) from None
        longest = float(np.abs(step).max())
        if not np.isfinite(longest):
            raise NoSheetEquilibriumError("the sheet is not held, or has lost its stiffness")
        share = min(1.0, LONGEST_STEP * size / longest) if longest > 0 else 1.0
        u = u + share * step.reshape(u.shape)
        gap = (1 - share) * gap
        if longest < CONVERGED_STEP * size:
            if system.is_folded(u):
                raise NoSheetEquilibriumError("a triangle has folded over")
            return u
    raise NoSheetEquilibriumError(
        f"Newton's method did not converge in {MOST_ITERATIONS} iterations"
    )


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

"""Equilibrium of a body between plates: energy, force and tangent of all parts, Newton's method.

Newton's method has a line search on the energy, summed over all parts.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix

from palpate.storage.errors import PalpateError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver import plate_contact
from palpate.workers.blind.solver.plate_contact import Plate, Skin
from palpate.workers.blind.solver.quadratic_mesh import (
    FACE_WEIGHTS,
    QuadraticMesh,
    face_areas,
    face_shapes,
)
from palpate.workers.blind.solver.tissue_energy import (
    Cells,
    ElementMaterials,
    Sheet,
    add_sheet,
    add_tissue_forces,
    add_tissue_tangent,
    cells_of,
    sheet_energy,
    tissue_energy,
)
from palpate.workers.blind.solver.two_level_solver import (
    Coarsening,
    LinearSolution,
    Pattern,
    TwoLevel,
    block_product,
    coarsening_of,
    conjugate_gradients,
    factorised_coarse_tangent,
    pattern_of,
    slots_of,
)

DENSITY_T_PER_MM3 = 1.0e-9
GRAVITY_MM_PER_S2 = 9810.0


@dataclass(frozen=True, eq=False)
class Topology:
    """Data that depend only on the mesh."""

    mesh: QuadraticMesh
    cells: Cells
    pattern: Pattern
    coarsening: Coarsening
    slots: NDArray[np.int32]
    face_slots: NDArray[np.int32]
    skin: Skin


def topology_of(mesh: QuadraticMesh) -> Topology:
    """Prepare a mesh for the kernels."""
    pattern = pattern_of(mesh.cells, len(mesh.nodes))
    return Topology(
        mesh,
        cells_of(mesh),
        pattern,
        coarsening_of(mesh, pattern),
        slots_of(mesh.cells, *pattern),
        slots_of(mesh.skin, *pattern),
        plate_contact.skin_of(mesh),
    )


@dataclass(frozen=True, eq=False)
class Wall:
    """Support of the body by the chest wall.

    Parameters
    ----------
    spring : ndarray, shape (k, 6, 3)
        Stiffness in MPa/mm along x, y and z at the six points of every face of the wall.
    held : bool
        Whether the wall is fixed along z, apart from its rise.
    rise_mm : ndarray, shape (n,), optional
        Forward motion of the wall and, at other nodes, an initial guess of the motion that it
        causes.
    """

    spring: FloatArray
    held: bool = True
    rise_mm: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class State:
    """Displacement (n, 3) in mm and travel of the plates, in mm."""

    u: FloatArray
    travel: float

    def plus(self, step: "State", fraction: float = 1.0) -> "State":
        """Return the state after a fraction of a step."""
        return State(self.u + fraction * step.u, self.travel + fraction * step.travel)


@dataclass(frozen=True, eq=False)
class Tangent:
    """Blocks (b, 3, 3), and the mixed (n, 3) and second derivatives with respect to the travel."""

    blocks: FloatArray
    border: FloatArray
    corner: float


class System:
    """A body with its materials and loads; friction depends on the loading path.

    Parameters
    ----------
    topology : Topology
    materials : Matter
    wall : Wall
    plates : tuple of Plate
        Lower and upper plate.
    friction : ndarray, shape (k, 6)
        Coulomb coefficient at the points of the skin.
    gravity_g : ndarray, shape (3,)
        Gravity in multiples of standard gravity.
    sheet : Sheet, optional
        A skin.
    tether : ndarray, shape (k, 6), optional
        Springs at the points of the skin along all axes, in MPa/mm.
    """

    def __init__(
        self,
        topology: Topology,
        materials: ElementMaterials,
        wall: Wall,
        plates: tuple[Plate, Plate],
        friction: FloatArray,
        gravity_g: FloatArray,
        sheet: Sheet | None = None,
        tether: FloatArray | None = None,
    ) -> None:
        self.topology = topology
        self.materials = self._grown = materials
        self.plates = plates
        self.sheet = sheet
        self.skin = topology.skin._replace(friction=friction)
        self.friction_states = (
            plate_contact.no_friction_yet(self.skin),
            plate_contact.no_friction_yet(self.skin),
        )
        self.weight = _weight(topology, gravity_g)
        self.springs = _spring_blocks(topology, topology.mesh.wall, wall.spring)
        if tether is not None:
            along_all = np.repeat(tether[..., None], 3, axis=2)
            self.springs += _spring_blocks(topology, topology.mesh.skin, along_all)
        self._rise_mm = wall.rise_mm
        self.free = np.ones(topology.mesh.nodes.shape, np.bool_)
        if wall.held:
            self.free[np.unique(topology.mesh.wall), 2] = False

    @property
    def has_friction(self) -> bool:
        """Return True if there is any friction."""
        return bool(self.skin.friction.any())

    def grow(self, part: float) -> None:
        """Apply a fraction of the tissue's growth, from 0 to 1."""
        growth = 1 + part * (self._grown.growth - 1)
        self.materials = self._grown._replace(growth=growth)

    def raised(self, state: State, part: float) -> State:
        """Return the state after a further fraction of the chest wall's rise.

        As an initial guess, material in front of the wall moves along, but less the further away it
        is.
        """
        if self._rise_mm is None:
            return state
        moved = np.zeros_like(state.u)
        moved[:, 2] = part * self._rise_mm
        return State(state.u + moved, state.travel)

    def energy(self, state: State, force_n: float) -> float:
        """Return the potential energy in mJ under the force that closes the plates."""
        u, t = state.u, state.travel
        total = tissue_energy(self.topology.cells, self.materials, u) - force_n * t
        total += 0.5 * float((u * self.spring_forces(u)).sum()) - float((u * self.weight).sum())
        if self.sheet is not None:
            total += sheet_energy(self.sheet, u)
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            total += plate_contact.contact_energy(self.skin, plate, friction_state, u, t)
        return float(total)

    def linearised(self, state: State, force_n: float, exact: bool = True) -> tuple[State, Tangent]:
        """Return the out-of-balance force, zero at fixed components, and the tangent.

        Unless `exact`, friction has a stiffness above its tangent, which allows longer steps far
        from the solution.
        """
        top, u, t = self.topology, state.u, state.travel
        force = self.spring_forces(u) - self.weight
        add_tissue_forces(top.cells, self.materials, u, force)
        blocks = self.springs.copy()
        add_tissue_tangent(top.cells, self.materials, u, top.slots, blocks)
        if self.sheet is not None:
            add_sheet(self.sheet, u, top.face_slots, force, blocks)
        border = np.zeros_like(u)
        closing, corner = -force_n, 0.0
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            on_travel, stiff = plate_contact.add_contact(
                self.skin, plate, friction_state, u, t, top.face_slots, exact, force, border, blocks
            )
            closing += on_travel
            corner += stiff
        force[~self.free] = 0.0
        border[~self.free] = 0.0
        self._hold(blocks)
        return State(force, closing), Tangent(blocks, border, corner)

    def renew_friction(self, state: State) -> None:
        """Limit friction by the contact pressure of this state."""
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            plate_contact.renew_pressure(self.skin, plate, friction_state, state.u, state.travel)

    def end_step(self, state: State) -> None:
        """Store this state as the new reference for friction."""
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            plate_contact.update_friction_origin(self.skin, plate, friction_state, state.u)

    def spring_forces(self, u: FloatArray) -> FloatArray:
        """Return the nodal forces on the springs of the wall and the skin, (n, 3) in N."""
        starts, columns = self.topology.pattern
        out = np.empty_like(u)
        block_product(starts, columns, self.springs, u, out)
        return out

    def _hold(self, blocks: FloatArray) -> None:
        starts, columns = self.topology.pattern
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        blocks *= self.free[rows][:, :, None] & self.free[columns][:, None, :]
        diagonal = np.flatnonzero(rows == columns)
        blocks[diagonal] += np.eye(3) * ~self.free[rows[diagonal]][:, :, None]


def _weight(top: Topology, gravity_g: FloatArray) -> FloatArray:
    """Return consistent nodal forces of gravity; the integrals of N are -V/20 and V/5."""
    parts = np.repeat([-0.05, 0.2], [4, 6])
    shares = np.bincount(
        top.cells.nodes.ravel(), np.outer(top.cells.volumes, parts).ravel(), len(top.mesh.nodes)
    )
    return np.outer(shares, DENSITY_T_PER_MM3 * GRAVITY_MM_PER_S2 * np.asarray(gravity_g))


def _spring_blocks(top: Topology, faces: IntArray, spring: FloatArray) -> FloatArray:
    """Return springs (k, 6, 3) per area of faces (k, 6), as blocks of the tangent."""
    blocks = np.zeros((len(top.pattern.columns), 3, 3))
    if not len(faces):
        return blocks
    shapes = face_shapes()
    areas = face_areas(top.mesh, faces)[:, None] * FACE_WEIGHTS
    local = np.einsum("kq,kqi,qa,qb->kabi", areas, spring, shapes, shapes, optimize=True)
    slots = slots_of(np.ascontiguousarray(faces), *top.pattern)
    for i in range(3):
        np.add.at(blocks[:, i, i], slots.ravel(), local[..., i].ravel())
    return blocks


FORCE_TOLERANCE = 2e-5  # fraction of the plate's force that may be out of balance
EXACT_FRICTION_BELOW = 0.02  # fraction of the force below which friction has its exact tangent
MAX_STEPS = 120
ENERGY_SLACK = 1e-9  # fraction of the energy that rounding may add


class NoEquilibriumError(PalpateError):
    """Failure of Newton's method to find an equilibrium."""


@dataclass(frozen=True, slots=True)
class SolverEffort:
    """Numbers of Newton steps and of conjugate gradient iterations."""

    steps: int
    iterations: int


def interpolation_of(system: System) -> csc_matrix:
    """Return the interpolation matrix from corners to all nodes, (n, c)."""
    ends = system.topology.mesh.ends
    rows = np.repeat(np.arange(len(ends)), 2)
    shape = (len(ends), system.topology.mesh.corners)
    return coo_matrix((np.full(2 * len(ends), 0.5), (rows, ends.ravel())), shape=shape).tocsc()


class Newton:
    """Equilibrium solver that reuses the coarse factorisation between solutions.

    Parameters
    ----------
    system : System
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.interpolation = interpolation_of(system)
        starts, columns = system.topology.pattern
        self._diagonal = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) == columns
        self._factor: Any = None
        self._fresh = 0
        self._last = 0

    def equilibrium(
        self, state: State, force_n: float, tolerance: float = FORCE_TOLERANCE
    ) -> tuple[State, SolverEffort]:
        """Find the equilibrium under a force, from a state near it.

        Parameters
        ----------
        state : State
        force_n : float
            Force that closes the plates.
        tolerance : float
            Fraction of that force that may be out of balance.

        Returns
        -------
        State, Effort

        Raises
        ------
        NoEquilibriumError
            If the iteration does not converge.
        """
        system = self.system
        total = 0
        before = np.inf
        for step in range(MAX_STEPS):
            if system.has_friction:
                system.renew_friction(state)
            force, tangent = system.linearised(state, force_n, exact=before < EXACT_FRICTION_BELOW)
            size = float(np.sqrt((force.u**2).sum() + force.travel**2)) / force_n
            if size < tolerance:
                return state, SolverEffort(step, total)
            forcing = min(0.1, max(0.003, 0.5 * (size / before) if np.isfinite(before) else 0.1))
            before = size
            solved = self._solve(force, tangent, forcing)
            total += solved.iterations
            moved = self._searched(state, State(solved.u, solved.travel), force, force_n)
            if moved is None:
                # A factorisation from an unstable state may point uphill; nodal scaling does not.
                self._factor = None
                moved = self._searched(state, self._downhill(force, tangent), force, force_n)
            if moved is None:
                break
            state = moved
        # A factorisation from this state would mislead another attempt.
        self._factor = None
        raise NoEquilibriumError(
            f"No equilibrium under {force_n:g} N: {size:.1e} of the force is out of balance "
            f"after {step + 1} steps."
        )

    def _solve(self, force: State, tangent: Tangent, tolerance: float) -> LinearSolution:
        top = self.system.topology
        inverses = np.linalg.inv(tangent.blocks[self._diagonal])
        if self._factor is None or self._last > 1.3 * self._fresh + 5:
            self._factor = factorised_coarse_tangent(
                top.coarsening, tangent.blocks, tangent.border, tangent.corner, self.interpolation
            )
            self._fresh = 0
        cycle = TwoLevel(
            top.pattern, tangent.blocks, tangent.border, inverses, self.interpolation, self._factor
        )
        solved = conjugate_gradients(cycle, tangent.corner, force.u, force.travel, tolerance)
        self._last = solved.iterations
        self._fresh = self._fresh or solved.iterations
        return solved

    def _downhill(self, force: State, tangent: Tangent) -> State:
        """Return a steepest-descent step, scaled by the stiffness of each node."""
        stiffness = np.abs(tangent.blocks[self._diagonal]).sum(axis=2)
        return State(-force.u / stiffness, -force.travel / max(tangent.corner, 1.0))

    def _searched(self, state: State, step: State, force: State, force_n: float) -> State | None:
        """Return the state after a backtracking line search (Armijo), or None."""
        energy = self.system.energy(state, force_n)
        slope = float((force.u * step.u).sum()) + force.travel * step.travel
        fraction = 1.0
        for _ in range(25):
            trial = state.plus(step, fraction)
            trial_energy = self.system.energy(trial, force_n)
            if trial_energy <= energy + 1e-4 * fraction * slope + ENERGY_SLACK * abs(energy):
                return trial
            fraction *= 0.5
        return None

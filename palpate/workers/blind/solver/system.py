"""Energy, out-of-balance force and tangent of a body between plates, summed over all parts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver import contact
from palpate.workers.blind.solver.contact import Plate, Skin
from palpate.workers.blind.solver.element_energy import (
    Cells,
    ElementMaterials,
    add_forces,
    add_tangent,
    cells_of,
    energy,
)
from palpate.workers.blind.solver.quadratic_element import (
    FACE_WEIGHTS,
    QuadraticMesh,
    face_areas,
    face_shapes,
)
from palpate.workers.blind.solver.skin_membrane import Sheet, add_sheet, sheet_energy
from palpate.workers.blind.solver.sparsity import (
    Coarsening,
    Pattern,
    coarsening_of,
    pattern_of,
    slots_of,
)
from palpate.workers.blind.solver.two_level_solver import block_product

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
        contact.skin_of(mesh),
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
            contact.no_friction_yet(self.skin),
            contact.no_friction_yet(self.skin),
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
        total = energy(self.topology.cells, self.materials, u) - force_n * t
        total += 0.5 * float((u * self.spring_forces(u)).sum()) - float((u * self.weight).sum())
        if self.sheet is not None:
            total += sheet_energy(self.sheet, u)
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            total += contact.contact_energy(self.skin, plate, friction_state, u, t)
        return float(total)

    def linearised(self, state: State, force_n: float, exact: bool = True) -> tuple[State, Tangent]:
        """Return the out-of-balance force, zero at fixed components, and the tangent.

        Unless `exact`, friction has a stiffness above its tangent, which allows longer steps far
        from the solution.
        """
        top, u, t = self.topology, state.u, state.travel
        force = self.spring_forces(u) - self.weight
        add_forces(top.cells, self.materials, u, force)
        blocks = self.springs.copy()
        add_tangent(top.cells, self.materials, u, top.slots, blocks)
        if self.sheet is not None:
            add_sheet(self.sheet, u, top.face_slots, force, blocks)
        border = np.zeros_like(u)
        closing, corner = -force_n, 0.0
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            on_travel, stiff = contact.add_contact(
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
            contact.renew_pressure(self.skin, plate, friction_state, state.u, state.travel)

    def end_step(self, state: State) -> None:
        """Store this state as the new reference for friction."""
        for plate, friction_state in zip(self.plates, self.friction_states, strict=True):
            contact.update_friction_origin(self.skin, plate, friction_state, state.u)

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

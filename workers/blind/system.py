"""All that acts on a body between plates: energy, out-of-balance force, tangent."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from storage.values import FloatArray, IntArray
from workers.blind import contact
from workers.blind.contact import Plate, Skin
from workers.blind.element import FACE_WEIGHTS, QuadraticMesh, face_areas, face_shapes
from workers.blind.linear import product
from workers.blind.sheet import Sheet, add_sheet, sheet_energy
from workers.blind.sparsity import Coarsening, Pattern, coarsening_of, pattern_of, slots_of
from workers.blind.tissue import Cells, Matter, add_forces, add_tangent, cells_of, energy

DENSITY_T_PER_MM3 = 1.0e-9
GRAVITY_MM_PER_S2 = 9810.0


@dataclass(frozen=True, eq=False)
class Topology:
    """What a mesh alone decides."""

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
    """How the chest wall holds the body.

    Parameters
    ----------
    spring : ndarray, shape (k, 6, 3)
        MPa/mm along x, y and z at the six points of every face of the wall.
    held : bool
        Whether nothing of it moves along z.
    """

    spring: FloatArray
    held: bool = True


@dataclass(frozen=True, eq=False)
class State:
    """Displacement (n, 3) in mm and how far the plates have closed, in mm."""

    u: FloatArray
    travel: float

    def plus(self, step: "State", fraction: float = 1.0) -> "State":
        """Moved on by part of a step."""
        return State(self.u + fraction * step.u, self.travel + fraction * step.travel)


@dataclass(frozen=True, eq=False)
class Tangent:
    """Blocks (b, 3, 3), the mixed derivative by the travel (n, 3) and the second one by it."""

    blocks: FloatArray
    border: FloatArray
    corner: float


class System:
    """A body, what it is made of and what acts on it; friction remembers its path.

    Parameters
    ----------
    topology : Topology
    matter : Matter
    wall : Wall
    plates : tuple of Plate
        Lower and upper.
    friction : ndarray, shape (k, 6)
        Coulomb's coefficient at the points of the skin.
    gravity_g : ndarray, shape (3,)
        In multiples of that of the earth.
    sheet : Sheet, optional
        A skin.
    """

    def __init__(
        self, topology: Topology, matter: Matter, wall: Wall, plates: tuple[Plate, Plate],
        friction: FloatArray, gravity_g: FloatArray, sheet: Sheet | None = None,
    ) -> None:  # fmt: skip
        self.topology = topology
        self.matter = matter
        self.plates = plates
        self.sheet = sheet
        self.skin = topology.skin._replace(friction=friction)
        self.grips = (contact.loose(self.skin), contact.loose(self.skin))
        self.weight = _weight(topology, gravity_g)
        self.springs = _spring_blocks(topology, wall)
        self.free = np.ones(topology.mesh.nodes.shape, np.bool_)
        if wall.held:
            self.free[np.unique(topology.mesh.wall), 2] = False

    @property
    def rubs(self) -> bool:
        """Whether there is any friction."""
        return bool(self.skin.friction.any())

    def energy(self, state: State, force_n: float) -> float:
        """Potential energy in mJ under the force that closes the plates."""
        u, t = state.u, state.travel
        total = energy(self.topology.cells, self.matter, u) - force_n * t
        total += 0.5 * float((u * self.pull_of_springs(u)).sum()) - float((u * self.weight).sum())
        if self.sheet is not None:
            total += sheet_energy(self.sheet, u)
        for plate, grip in zip(self.plates, self.grips, strict=True):
            total += contact.contact_energy(self.skin, plate, grip, u, t)
        return float(total)

    def linearised(self, state: State, force_n: float, exact: bool = True) -> tuple[State, Tangent]:
        """Out-of-balance force, zero where nothing is free, and tangent.

        Without `exact` friction has a stiffness above its tangent: far from the end it
        leads there in longer steps.
        """
        top, u, t = self.topology, state.u, state.travel
        force = self.pull_of_springs(u) - self.weight
        add_forces(top.cells, self.matter, u, force)
        blocks = self.springs.copy()
        add_tangent(top.cells, self.matter, u, top.slots, blocks)
        if self.sheet is not None:
            add_sheet(self.sheet, u, top.face_slots, force, blocks)
        border = np.zeros_like(u)
        closing, corner = -force_n, 0.0
        for plate, grip in zip(self.plates, self.grips, strict=True):
            on_travel, stiff = contact.add_contact(
                self.skin, plate, grip, u, t, top.face_slots, exact, force, border, blocks
            )
            closing += on_travel
            corner += stiff
        force[~self.free] = 0.0
        border[~self.free] = 0.0
        self._hold(blocks)
        return State(force, closing), Tangent(blocks, border, corner)

    def renew_friction(self, state: State) -> None:
        """Limit friction by the pressure of this state."""
        for plate, grip in zip(self.plates, self.grips, strict=True):
            contact.renew_pressure(self.skin, plate, grip, state.u, state.travel)

    def end_step(self, state: State) -> None:
        """Let friction remember this state."""
        for plate, grip in zip(self.plates, self.grips, strict=True):
            contact.slide(self.skin, plate, grip, state.u)

    def pull_of_springs(self, u: FloatArray) -> FloatArray:
        """Force of the nodes on the springs of the wall, (n, 3) in N."""
        starts, columns = self.topology.pattern
        out = np.empty_like(u)
        product(starts, columns, self.springs, u, out)
        return out

    def _hold(self, blocks: FloatArray) -> None:
        starts, columns = self.topology.pattern
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        blocks *= self.free[rows][:, :, None] & self.free[columns][:, None, :]
        diagonal = np.flatnonzero(rows == columns)
        blocks[diagonal] += np.eye(3) * ~self.free[rows[diagonal]][:, :, None]


def _weight(top: Topology, gravity_g: FloatArray) -> FloatArray:
    """Consistent nodal forces of gravity: integrals of N are -V/20 and V/5."""
    parts = np.repeat([-0.05, 0.2], [4, 6])
    shares = np.bincount(
        top.cells.nodes.ravel(), np.outer(top.cells.volumes, parts).ravel(), len(top.mesh.nodes)
    )
    return np.outer(shares, DENSITY_T_PER_MM3 * GRAVITY_MM_PER_S2 * np.asarray(gravity_g))


def _spring_blocks(top: Topology, wall: Wall) -> FloatArray:
    """Springs per area of the wall, as blocks of the tangent."""
    blocks = np.zeros((len(top.pattern.columns), 3, 3))
    faces: IntArray = top.mesh.wall
    if not len(faces):
        return blocks
    shapes = face_shapes()
    areas = face_areas(top.mesh, faces)[:, None] * FACE_WEIGHTS
    local = np.einsum("kq,kqi,qa,qb->kabi", areas, wall.spring, shapes, shapes, optimize=True)
    slots = slots_of(np.ascontiguousarray(faces), *top.pattern)
    for i in range(3):
        np.add.at(blocks[:, i, i], slots.ravel(), local[..., i].ravel())
    return blocks

"""One mesh under one problem: energy, out-of-balance force and tangent at a state.

A level is immutable: what depends on the load path, friction and follower pressure, is the
`History` of a state, which is passed in and returned.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import Float32Array
from palpate.workers.mechanics.fem import element_energy, membrane, sparse_products
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.discretisation import LevelModel, Stage, State
from palpate.workers.mechanics.fem.element_laws import (
    Barrier,
    ElementConstants,
    barrier_assemble,
    barrier_energy,
    barrier_of,
    element_constants,
    law_assemble,
    law_energy,
)
from palpate.workers.mechanics.fem.external_forces import (
    dead_load,
    dirichlet_conditions,
    pressure_forces,
    spring_stiffness,
)
from palpate.workers.mechanics.fem.plate_contact import (
    PlateContact,
    PlateFriction,
    edge_stiffness,
    penalty_potential,
    plate_contact,
)
from palpate.workers.mechanics.fem.plate_surface import ContactPotential, no_contact
from palpate.workers.mechanics.fem.simd_vectors import EDGE
from palpate.workers.mechanics.fem.tangent_assembly import assemble


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy of a state, with the quantities it was computed from.

    Parameters
    ----------
    elastic : float
        Stored in the body, its skin and its springs, in mJ.
    potential : float
        Total potential energy, minimal in equilibrium, in mJ.
    nodal_volumes : ndarray, shape (n,)
    plate_contacts : tuple of PlateContact
        The lower and the upper plate.
    contact : ContactPotential
        Plates and friction.
    """

    elastic: float
    potential: float
    nodal_volumes: FloatArray
    plate_contacts: tuple[PlateContact, ...]
    contact: ContactPotential

    @property
    def plate_forces(self) -> tuple[float, float]:
        """Force on the lower and the upper plate in N."""
        if not self.plate_contacts:
            return 0.0, 0.0
        lower, upper = (float(p.normal_force.sum()) for p in self.plate_contacts)
        return lower, upper


@dataclass(frozen=True, eq=False)
class Tangent:
    """Second derivative of the energy.

    Parameters
    ----------
    rows : ndarray of float32, shape (edges, 12)
        Packed rows, see `workers.mechanics.fem.sparse_products`.
    contact_index : ndarray of int32, shape (c,)
        The nodes on which `coupling` acts.
    coupling : ndarray, shape (c, 3)
        Border of the tangent: derivatives in the travel of the plates, in N/mm.
    plate_stiffness : float
        Corner of the border; zero means that the plates do not move.
    """

    rows: Float32Array
    contact_index: IntArray
    coupling: FloatArray
    plate_stiffness: float


@dataclass(frozen=True, eq=False)
class Level:
    """A `LevelModel` under one `Problem`; `Level.build` makes one.

    Parameters
    ----------
    model : LevelModel
    problem : Problem
    constants : ElementConstants
    nodal_bulk_mpa : ndarray, shape (n,)
        Bulk modulus kappa_n of the nodal average; zero with plain elements.
    springs : ndarray, shape (n, 3)
        Stiffness of the springs that hold each node in place, in N/mm.
    dead_load : ndarray, shape (n, 3)
        Gravity and forces that keep their direction, in N.
    free : ndarray of float32, shape (n, 3)
        1 where a displacement is unknown, 0 where it is prescribed.
    prescribed_mm : ndarray, shape (n, 3)
        Prescribed displacements at the full load.
    rounding_mj : float
        Energies are differences of terms of this size, each with 16 digits.
    barrier : Barrier, optional
        Against the collapse of elements; see `with_barrier`.
    """

    model: LevelModel
    problem: Problem
    constants: ElementConstants
    nodal_bulk_mpa: FloatArray
    springs: FloatArray
    dead_load: FloatArray
    free: Float32Array
    prescribed_mm: FloatArray
    rounding_mj: float
    barrier: Barrier | None = None

    @classmethod
    def build(cls, model: LevelModel, problem: Problem, similar: "Level | None" = None) -> "Level":
        """Prepare a level.

        Parameters
        ----------
        model, problem : LevelModel and Problem
        similar : Level, optional
            Level of another problem; common parts are taken from it.

        Raises
        ------
        InputError
            If the mesh contains a tissue that has no constants.
        """
        near = similar if similar is not None and similar.model is model else None
        constants = element_constants(model, problem, near.constants if near else None)
        shared = near is not None and near.constants is constants
        conditions = dirichlet_conditions(model, problem)
        return cls(
            model=model,
            problem=problem,
            constants=constants,
            nodal_bulk_mpa=near.nodal_bulk_mpa
            if near is not None and shared
            else _nodal_bulk_mpa(model, problem, constants),
            springs=spring_stiffness(model, problem),
            dead_load=dead_load(model, problem, constants.density),
            free=(~conditions.held).astype(np.float32),
            prescribed_mm=conditions.displacement_mm,
            rounding_mj=1e-14 * _stiffness_mj(model, constants),
            barrier=None if near is None or near.barrier is None else barrier_of(model, problem),
        )

    def with_barrier(self) -> "Level":
        """Return the level with a barrier against the collapse of its elements."""
        return replace(self, barrier=barrier_of(self.model, self.problem))

    @property
    def skin_n_per_mm(self) -> float:
        """Shear stiffness mu t of the skin; zero without skin."""
        skin = self.problem.membrane
        return 0.0 if skin is None else skin.young_mpa / 3 * skin.thickness_mm

    @property
    def skin_wrinkles(self) -> bool:
        """Whether there is skin, and it wrinkles."""
        return self.problem.membrane is not None and self.problem.membrane.wrinkles

    def is_conservative(self, state: State) -> bool:
        """Check whether all forces have an energy: no friction and no follower pressure."""
        return not state.history.friction and not self.problem.pressures

    def with_prescribed(self, x: FloatArray, fraction: float) -> FloatArray:
        """Return `x` with the prescribed displacements at a fraction of the load."""
        return np.where(self.free > 0, x, self.model.nodes + fraction * self.prescribed_mm)

    def begin_step(self, state: State, stage: Stage) -> State:
        """Begin a load step at `state`, from which slip is measured."""
        coefficient = stage.device.friction
        if not coefficient:
            return state
        nodes, before = self.model.contact_nodes, state.history.friction
        here = state.x[nodes.index]
        origins = [f.next_slip_origin(state.x, state.travel_mm) for f in before] or [here, here]
        friction = tuple(
            PlateFriction(nodes, p.surface, coefficient, origin, state.travel_mm, p.normal_force)
            for p, origin in zip(self.plate_contacts(state, stage), origins, strict=True)
        )
        return replace(state, history=replace(state.history, friction=friction))

    def update_history(self, state: State, stage: Stage) -> State:
        """Update friction and follower pressure for the current positions."""
        history = state.history
        if history.friction:
            contacts = self.plate_contacts(state, stage)
            pairs = zip(history.friction, contacts, strict=True)
            history = replace(history, friction=tuple(f.with_contact(c) for f, c in pairs))
        if self.problem.pressures:
            force = pressure_forces(self.model, state.x, self.problem.pressures)
            history = replace(history, follower_force=force)
        return replace(state, history=history)

    def energy(self, state: State, stage: Stage) -> Energy:
        """Return the energy of the body, its plates and its loads."""
        m, x = self.model, state.x
        volumes = np.empty(len(m.nodes))
        elastic = element_energy.energy(x, m.elements, self.constants.material, volumes)
        elastic += sum(law_energy(x, m.elements, part) for part in self.constants.laws)
        if self.barrier is not None:
            elastic += barrier_energy(x, m.elements, self.barrier)
        swelling = volumes / m.nodal_volumes - self.constants.nodal_growth
        elastic += 0.5 * float(self.nodal_bulk_mpa @ (m.nodal_volumes * swelling**2))
        u = x - m.nodes
        elastic += 0.5 * float(np.vdot(self.springs, u * u))
        if self.skin_n_per_mm:
            skin = self.skin_n_per_mm, self.skin_wrinkles
            elastic += membrane.sheet_energy(x, *m.sheet.arrays, *skin)
        plate_contacts, contact = self.contact(state, stage)
        work = stage.fraction * float(np.vdot(self._load(state), u))
        if stage.force_n is not None:
            work += stage.force_n * state.travel_mm
        return Energy(elastic, elastic + contact.energy - work, volumes, plate_contacts, contact)

    def contact(
        self, state: State, stage: Stage
    ) -> tuple[tuple[PlateContact, ...], ContactPotential]:
        """Return the plates, and the energy of plates and friction."""
        contacts = self.plate_contacts(state, stage)
        total = no_contact(self.model.contact_nodes)
        for contact in contacts:
            total += penalty_potential(contact)
        for friction in state.history.friction:
            total += friction.potential(state.x, state.travel_mm)
        return contacts, total

    def plate_contacts(self, state: State, stage: Stage) -> tuple[PlateContact, ...]:
        """Return the contact with the lower and the upper plate; empty without plates."""
        nodes = self.model.contact_nodes
        return tuple(plate_contact(nodes, state.x, p) for p in stage.plates(state.travel_mm))

    def linearise(
        self,
        state: State,
        at: Energy,
        stage: Stage,
        *,
        convex: bool = False,
        positive: bool = False,
        everywhere: bool = False,
    ) -> tuple[FloatArray, Tangent]:
        """Return the out-of-balance force, shape (n, 3) in N, and the tangent.

        Both are zero where a displacement is prescribed, unless computed `everywhere`. With
        `convex`, parts that may be negative are left out; with `positive`, all such parts of the
        matrix and its fibres are left out; see `assembly`.
        """
        m, g = self.model, self.model.graph
        free = np.ones_like(self.free) if everywhere else self.free
        packed = np.zeros((len(g.neighbour), EDGE), np.float32)
        force = self._force(state, at, stage, packed, convex or positive, positive)
        blocks = packed.reshape(-1, 3, 4)
        for axis in range(3):
            blocks[g.diagonal, axis, axis] += self.springs[:, axis]
        index = m.contact_nodes.index
        blocks[g.diagonal[index], :, :3] += at.contact.stiffness
        coupling = at.contact.coupling
        for contact in at.plate_contacts:
            if convex and contact.surface.edge is not None:
                blocks[g.diagonal[index], :, :3] -= edge_stiffness(contact)
            if contact.at_edge is None:
                continue
            # Faces share their edges: what several add to one block is summed.
            rows = m.sheet_edge[contact.at_edge.active].ravel()
            pairs = contact.at_edge.stiffness(convex=convex).reshape(-1, 3, 3)
            np.add.at(blocks[:, :, :3], rows, pairs)
            if convex:
                coupling = coupling - contact.at_edge.share_coupling
        sparse_products.clear_held_rows(g.start, free, packed)
        stiffness = at.contact.travel_stiffness if stage.force_n is not None else 0.0
        return force * free, Tangent(packed, index, coupling * free[index], stiffness)

    def force(self, state: State, at: Energy, stage: Stage) -> FloatArray:
        """Return the out-of-balance force on every node, held or not, shape (n, 3) in N."""
        return self._force(state, at, stage, np.zeros((0, EDGE), np.float32))

    def outer_force(self, state: State, contact: ContactPotential, stage: Stage) -> FloatArray:
        """Return the out-of-balance force of springs, loads and plates, without body and skin."""
        m = self.model
        force = self.springs * (state.x - m.nodes)
        force -= stage.fraction * self._load(state)
        force[m.contact_nodes.index] += contact.force
        return force

    def _load(self, state: State) -> FloatArray:
        """Return dead load and follower pressure at the full load, shape (n, 3) in N."""
        follower = state.history.follower_force
        return self.dead_load if follower is None else self.dead_load + follower

    def _force(
        self,
        state: State,
        at: Energy,
        stage: Stage,
        packed: Float32Array,
        convex: bool = False,
        positive: bool = False,
    ) -> FloatArray:
        """Return the force on every node, and add the tangent of body and skin to `packed`."""
        m, x, laws = self.model, state.x, self.constants.laws
        force = self.outer_force(state, at.contact, stage)
        swelling = at.nodal_volumes / m.nodal_volumes - self.constants.nodal_growth
        pressure = self.nodal_bulk_mpa * swelling
        edge, root = m.graph.edge, np.sqrt(self.nodal_bulk_mpa / m.nodal_volumes)
        material = self.constants.material
        assemble(x, m.elements, material, pressure, root, edge, convex, positive, force, packed)
        if not (laws or self.skin_n_per_mm or self.barrier):
            return force
        K = np.zeros((len(packed), 9), np.float32)
        for part in laws:
            law_assemble(x, m.elements, part, edge, force, K)
        if self.barrier is not None:
            barrier_assemble(x, m.elements, self.barrier, edge, convex, force, K)
        if self.skin_n_per_mm:
            skin = self.skin_n_per_mm, self.skin_wrinkles
            membrane.sheet_assemble(x, *m.sheet.arrays, *skin, m.sheet_edge, force, K)
        if len(packed):
            # Of a skin alone few rows are touched. An edge that is named twice is added once.
            some = slice(None) if laws or self.barrier else m.sheet_edge.ravel()
            packed.reshape(-1, 3, 4)[some, :, :3] += K[some].reshape(-1, 3, 3)
        return force


def _nodal_bulk_mpa(model: LevelModel, problem: Problem, constants: ElementConstants) -> FloatArray:
    """Average harmonically: a node between a stiff and a soft tissue yields like the soft one."""
    if problem.plain_elements:
        return np.zeros(len(model.nodes))
    elements = model.elements
    share = np.repeat(elements.volumes / (4 * constants.material.kappa), 4)
    return np.asarray(
        model.nodal_volumes / np.bincount(elements.tets.ravel(), share, len(model.nodes))
    )


def _stiffness_mj(model: LevelModel, constants: ElementConstants) -> float:
    """Return the shear modulus of the whole body times its volume."""
    total = float(constants.material.mu @ model.elements.volumes)
    for part in constants.laws:
        weighted = float(part.weight @ model.elements.volumes[part.elements])
        total += part.law.shear_modulus_mpa * weighted
    return total


def without_laws(problem: Problem) -> Problem:
    """Return the same problem with a neo-Hookean matrix of the same stiffness at rest."""
    constants = {t: replace(c, law=None) for t, c in problem.constants.items()}
    return replace(problem, constants=constants)

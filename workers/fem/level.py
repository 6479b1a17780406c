"""One mesh under one problem: energy, out-of-balance force and tangent at a state."""

from dataclasses import dataclass, replace

import numpy as np

from storage.values import FloatArray, IntArray
from workers.fem import kernels, membrane, rows
from workers.fem.assembly import assemble
from workers.fem.composition import Composition, compose
from workers.fem.contact import (
    Bordered,
    Gap,
    Press,
    Surface,
    normal_contact,
    nothing,
    press,
    surfaces,
)
from workers.fem.edges import EDGE
from workers.fem.friction import Grip
from workers.fem.kernels import Float32Array
from workers.fem.laws import law_assemble, law_energy
from workers.fem.loads import Device
from workers.fem.model import LevelModel
from workers.fem.outside import dead_forces, held_places, pressure_forces, springs
from workers.fem.problem import Problem


@dataclass(frozen=True, eq=False)
class State:
    """Positions, shape (n, 3) in mm, and how far the plates have closed, in mm."""

    x: FloatArray
    travel_mm: float


@dataclass(frozen=True, slots=True)
class Stage:
    """What acts at one moment of the loading.

    Parameters
    ----------
    gap : Gap or None
        Where the plates stand at zero travel; None without plates.
    force_n : float or None
        What the plates carry; None where they stay at `gap`.
    fraction : float
        Of gravity, forces, pressures and prescribed displacements.
    device : Device
    """

    gap: Gap | None
    force_n: float | None
    fraction: float
    device: Device

    def gap_at(self, travel_mm: float) -> Gap | None:
        """Where the plates stand along the axis after `travel_mm`."""
        if self.gap is None or self.force_n is None:
            return self.gap
        return self.gap.closed_by(travel_mm, self.device.lower_share)

    def plates(self, travel_mm: float) -> tuple[Surface, ...]:
        """The plates after `travel_mm`."""
        gap = self.gap_at(travel_mm)
        return () if gap is None else surfaces(self.device, gap)


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy of a state and what it came from.

    Parameters
    ----------
    elastic : float
        Stored in the body, its skin and its springs, in mJ.
    potential : float
        What an equilibrium makes least, in mJ.
    nodal_volumes : ndarray, shape (n,)
    presses : tuple of Press
        The lower and the upper plate.
    contact : Bordered
        Plates and friction.
    """

    elastic: float
    potential: float
    nodal_volumes: FloatArray
    presses: tuple[Press, ...]
    contact: Bordered

    @property
    def plate_forces(self) -> tuple[float, float]:
        """Force on the lower and the upper plate in N."""
        if not self.presses:
            return 0.0, 0.0
        lower, upper = (float(p.load.sum()) for p in self.presses)
        return lower, upper


@dataclass(frozen=True, eq=False)
class Tangent:
    """Second derivative of the energy: packed rows, (edges, 12), see `workers.fem.rows`.

    ``coupling`` (on ``pads``, shape (c, 3)) and ``plate_stiffness`` border it with
    the travel of the plates; zero stiffness means that they do not move.
    """

    rows: Float32Array
    pads: IntArray
    coupling: FloatArray
    plate_stiffness: float


class Level:
    """A `LevelModel` under one `Problem`.

    Friction and follower pressure have no energy. What they exert, `grips` and
    `follower`, is held while an energy is minimised; `renew` brings it up to date.
    """

    def __init__(self, model: LevelModel, problem: Problem, like: "Level | None" = None) -> None:
        """Make ready; what `like`, a level of another problem, has in common is taken from it."""
        self.model = model
        self.problem = problem
        near = like if like is not None and like.model is model else None
        self.made_of: Composition = compose(model, problem, near.made_of if near else None)
        self.matter, self.laws = self.made_of.matter, self.made_of.laws
        self.kappa: FloatArray = (
            near.kappa if near and near.made_of is self.made_of else self._nodal_kappa()
        )
        skin = problem.membrane
        self.skin_n_per_mm = 0.0 if skin is None else skin.young_mpa / 3 * skin.thickness_mm
        self.wrinkles = skin is not None and skin.wrinkles
        self.springs = springs(model, problem.wall, problem.load)
        self.dead = dead_forces(model, problem, self.made_of.density)
        places = held_places(model, problem)
        self.free = (~places.held).astype(np.float32)
        self.prescribed = places.displacement_mm
        self.grips: tuple[Grip, ...] = ()
        self.follower = np.zeros_like(model.nodes)
        # Energies are differences of terms of this size, each with 16 digits.
        self.rounding_mj = 1e-14 * float(self.matter.mu @ model.elements.volumes)
        # Kept by the smoother from one tangent to the next.
        self.stiffest_mode: Float32Array | None = None

    def _nodal_kappa(self) -> FloatArray:
        """Harmonic mean: a node between a stiff and a soft tissue yields like the soft one."""
        m = self.model
        if self.problem.plain_elements:
            return np.zeros(len(m.nodes))
        share = np.repeat(m.elements.volumes / (4 * self.matter.kappa), 4)
        return np.asarray(
            m.nodal_volumes / np.bincount(m.elements.tets.ravel(), share, len(m.nodes))
        )

    @property
    def lags(self) -> bool:
        """Whether anything acts that has no energy."""
        return bool(self.grips) or bool(self.problem.pressures)

    def placed(self, x: FloatArray, fraction: float) -> FloatArray:
        """`x` with the held places where they are prescribed."""
        return np.where(self.free > 0, x, self.model.nodes + fraction * self.prescribed)

    def begin_step(self, state: State, stage: Stage) -> None:
        """A step of the load begins at `state`: from here on slip counts."""
        pads, friction = self.model.pads, stage.device.friction
        if friction:
            here = state.x[pads.nodes]
            anchors = [g.anchor(state.x, state.travel_mm) for g in self.grips] or [here, here]
            self.grips = tuple(
                Grip(pads, p.surface, friction, anchor, state.travel_mm, p.load)
                for p, anchor in zip(self._presses(state, stage), anchors, strict=True)
            )

    def renew(self, state: State, stage: Stage) -> None:
        """Bring friction and follower pressure up to the present state."""
        if self.grips:
            presses = self._presses(state, stage)
            self.grips = tuple(g.renewed(p) for g, p in zip(self.grips, presses, strict=True))
        if self.problem.pressures:
            self.follower = pressure_forces(self.model, state.x, self.problem.pressures)

    def energy(self, state: State, stage: Stage) -> Energy:
        """Energy of the body, its plates and its loads."""
        m, x = self.model, state.x
        volumes = np.empty(len(m.nodes))
        elastic = kernels.energy(x, m.elements, self.matter, volumes)
        elastic += sum(law_energy(x, m.elements, share) for share in self.laws)
        swelling = volumes / m.nodal_volumes - 1
        elastic += 0.5 * float(self.kappa @ (m.nodal_volumes * swelling**2))
        u = x - m.nodes
        elastic += 0.5 * float(np.vdot(self.springs, u * u))
        if self.skin_n_per_mm:
            elastic += membrane.sheet_energy(x, *m.sheet.arrays, self.skin_n_per_mm, self.wrinkles)
        presses, contact = self.contact(state, stage)
        work = stage.fraction * float(np.vdot(self.dead + self.follower, u))
        if stage.force_n is not None:
            work += stage.force_n * state.travel_mm
        return Energy(elastic, elastic + contact.energy - work, volumes, presses, contact)

    def contact(self, state: State, stage: Stage) -> tuple[tuple[Press, ...], Bordered]:
        """The plates, and the energy of plates and friction."""
        presses = self._presses(state, stage)
        contact = nothing(self.model.pads)
        for p in presses:
            contact += normal_contact(p)
        for grip in self.grips:
            contact += grip.drag(state.x, state.travel_mm)
        return presses, contact

    def linearise(
        self,
        state: State,
        at: Energy,
        stage: Stage,
        *,
        convex: bool = False,
        everywhere: bool = False,
    ) -> tuple[FloatArray, Tangent]:
        """Out-of-balance force, shape (n, 3) in N, and tangent.

        Both are zero where a displacement is held, unless asked for `everywhere`.
        """
        m, g = self.model, self.model.graph
        free = np.ones_like(self.free) if everywhere else self.free
        packed = np.zeros((len(g.neighbour), EDGE), np.float32)
        force = self._force(state, at, stage, convex, packed)
        blocks = packed.reshape(-1, 3, 4)
        for axis in range(3):
            blocks[g.diagonal, axis, axis] += self.springs[:, axis]
        blocks[g.diagonal[m.pads.nodes], :, :3] += at.contact.stiffness
        rows.hold(g.start, free, packed)
        stiffness = at.contact.travel_stiffness if stage.force_n is not None else 0.0
        coupling = at.contact.coupling * free[m.pads.nodes]
        return force * free, Tangent(packed, m.pads.nodes, coupling, stiffness)

    def force(self, state: State, at: Energy, stage: Stage) -> FloatArray:
        """Out-of-balance force on every node, held or not, shape (n, 3) in N."""
        return self._force(state, at, stage, False, np.zeros((0, EDGE), np.float32))

    def outer_force(self, state: State, contact: Bordered, stage: Stage) -> FloatArray:
        """What springs, loads and plates leave out of balance, without body and skin."""
        m = self.model
        force = self.springs * (state.x - m.nodes)
        force -= stage.fraction * (self.dead + self.follower)
        force[m.pads.nodes] += contact.force
        return force

    def _force(
        self,
        state: State,
        at: Energy,
        stage: Stage,
        convex: bool,
        packed: Float32Array,
    ) -> FloatArray:
        m, x = self.model, state.x
        force = self.outer_force(state, at.contact, stage)
        pressure = self.kappa * (at.nodal_volumes / m.nodal_volumes - 1)
        edge, root = m.graph.edge, np.sqrt(self.kappa / m.nodal_volumes)
        assemble(x, m.elements, self.matter, pressure, root, edge, convex, force, packed)
        if not (self.laws or self.skin_n_per_mm):
            return force
        K = np.zeros((len(packed), 9), np.float32)
        for share in self.laws:
            law_assemble(x, m.elements, share, edge, force, K)
        if self.skin_n_per_mm:
            skin = self.skin_n_per_mm, self.wrinkles
            membrane.sheet_assemble(x, *m.sheet.arrays, *skin, m.sheet_edge, force, K)
        if len(packed):
            # Of a skin alone few rows are touched. An edge that is named twice is added once.
            some = slice(None) if self.laws else m.sheet_edge.ravel()
            packed.reshape(-1, 3, 4)[some, :, :3] += K[some].reshape(-1, 3, 3)
        return force

    def _presses(self, state: State, stage: Stage) -> tuple[Press, ...]:
        return tuple(press(self.model.pads, state.x, p) for p in stage.plates(state.travel_mm))


def without_laws(problem: Problem) -> Problem:
    """The same problem with a neo-Hookean matrix of the same stiffness at rest."""
    constants = {t: replace(c, law=None) for t, c in problem.constants.items()}
    return replace(problem, constants=constants)

"""One mesh with its constants: energy, out-of-balance force and tangent at a state."""

from dataclasses import dataclass

import numpy as np

from storage.errors import InputError
from storage.values import FloatArray, IntArray, Tissue
from workers.fem import kernels, membrane
from workers.fem.contact import Gap, Touch, touch
from workers.fem.kernels import Float32Array
from workers.fem.model import LevelModel
from workers.fem.problem import Problem

# Frictionless plates leave the body free to drift along x; springs this weak
# (5 mN per mm of drift for a litre) hold it without being felt.
DRIFT_SPRING_N_PER_MM4 = 5e-9


@dataclass(frozen=True, eq=False)
class State:
    """Positions, shape (n, 3) in mm, and how far the upper plate has moved, in mm."""

    x: FloatArray
    travel_mm: float


@dataclass(frozen=True, eq=False)
class Energy:
    """Stored energy in mJ, the nodal volumes it came from, and the contact."""

    stored: float
    nodal_volumes: FloatArray
    touch: Touch


@dataclass(frozen=True, eq=False)
class Tangent:
    """Second derivative of the energy: ``K + B diag(D) B^T``, see `workers.fem.operators`.

    ``coupling`` (on ``pads``, along y) and ``plate_stiffness`` border it with
    the travel of the upper plate; zero stiffness means the plate does not move.
    """

    K: Float32Array
    B: Float32Array
    D: FloatArray
    pads: IntArray
    coupling: FloatArray
    plate_stiffness: float


class Level:
    """A `LevelModel` under one `Problem`."""

    def __init__(self, model: LevelModel, problem: Problem) -> None:
        self.model = model
        self.fibre = _unit(problem.fibre)
        self.tension_only = not problem.literal_fibre
        self.plain = problem.plain_elements
        self.mu, self.eta, kappa = _constants(model, problem)
        self.element_kappa = kappa
        share = np.repeat(model.volumes / (4 * kappa), 4)
        # Harmonic mean: a node between a stiff and a soft tissue yields like the soft one.
        compliance = np.bincount(model.tets.ravel(), share, len(model.nodes))
        self.kappa = (0.0 if self.plain else 1.0) * model.nodal_volumes / compliance
        skin = problem.membrane
        self.skin_n_per_mm = 0.0 if skin is None else skin.young_mpa / 3 * skin.thickness_mm
        self.spring = DRIFT_SPRING_N_PER_MM4 * model.nodal_volumes
        self.free = np.ones(model.nodes.shape, np.float32)
        # Kept by the smoother from one tangent to the next.
        self.stiffest_mode: Float32Array | None = None
        for axis, fixed in enumerate(problem.wall_fixed):
            if fixed:
                self.free[model.wall, axis] = 0

    def energy(self, x: FloatArray, gap: Gap) -> Energy:
        """Energy of the body and of the plates' penalty at positions `x`."""
        m = self.model
        volumes = np.empty(len(m.nodes))
        stored = kernels.energy(
            x,
            m.tets,
            m.gradients,
            m.volumes,
            self.mu,
            self.eta,
            self.element_kappa,
            self.plain,
            self.fibre,
            self.tension_only,
            volumes,
        )
        stored += 0.5 * float(self.kappa @ (m.nodal_volumes * (volumes / m.nodal_volumes - 1) ** 2))
        stored += 0.5 * float(self.spring @ (x[:, 0] - m.nodes[:, 0]) ** 2)
        if self.skin_n_per_mm:
            s = m.sheet
            stored += membrane.sheet_energy(x, s.triangles, s.metric, s.area, self.skin_n_per_mm)
        contact = touch(m.pads, x, gap)
        return Energy(stored + contact.energy, volumes, contact)

    def linearise(
        self, x: FloatArray, at: Energy, *, moving_plate: bool, convex: bool = False
    ) -> tuple[FloatArray, Tangent]:
        """Out-of-balance force, shape (n, 3) in N, zero where held, and tangent at `x`."""
        m, g = self.model, self.model.graph
        force = np.zeros_like(x)
        K = np.zeros((len(g.neighbour), 9), np.float32)
        B = np.zeros((len(g.neighbour), 3), np.float32)
        pressure = self.kappa * (at.nodal_volumes / m.nodal_volumes - 1)
        kernels.assemble(
            x,
            m.tets,
            m.gradients,
            m.volumes,
            self.mu,
            self.eta,
            self.element_kappa,
            self.plain,
            self.fibre,
            self.tension_only,
            pressure,
            g.edge,
            convex,
            force,
            K,
            B,
        )
        if self.skin_n_per_mm:
            s = m.sheet
            membrane.sheet_assemble(
                x, s.triangles, s.metric, s.area, self.skin_n_per_mm, m.sheet_edge, force, K
            )
        force[:, 0] += self.spring * (x[:, 0] - m.nodes[:, 0])
        K[g.diagonal, 0] += self.spring
        force[m.pads.nodes, 1] += at.touch.force
        K[g.diagonal[m.pads.nodes], 4] += at.touch.stiffness
        force *= self.free
        coupling = at.touch.coupling * self.free[m.pads.nodes, 1]
        stiffness = float(coupling.sum()) if moving_plate else 0.0
        return force, Tangent(K, B, self.kappa / m.nodal_volumes, m.pads.nodes, coupling, stiffness)

    def wall_reaction(self, x: FloatArray, gap: Gap) -> float:
        """Force of the chest wall on the body along z, in N (positive pushes outwards)."""
        free, self.free = self.free, np.ones_like(self.free)
        force, _ = self.linearise(x, self.energy(x, gap), moving_plate=False)
        self.free = free
        return float(force[self.model.wall, 2].sum())


def _unit(direction: tuple[float, float, float]) -> FloatArray:
    a = np.asarray(direction, dtype=np.float64)
    length = float(np.linalg.norm(a))
    if not length > 0:
        raise InputError(f"The fibre direction must not be zero, got {direction}.")
    return a / length


def _constants(model: LevelModel, problem: Problem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """mu, eta and kappa per element, averaged over its tissues by volume."""
    table = np.zeros((model.fractions.shape[1], 3))
    for tissue, c in problem.constants.items():
        table[tissue] = c.mu_mpa, c.fibre_mpa, c.kappa_mpa
    missing = [
        Tissue(int(t)).name.lower()
        for t in np.flatnonzero(model.fractions.sum(axis=0) > 0)
        if table[t, 0] == 0
    ]
    if missing:
        raise InputError(f"The mesh contains {', '.join(missing)}, but no constants say how stiff.")
    mu, eta, kappa = (np.ascontiguousarray(c) for c in (model.fractions @ table).T)
    return mu, eta, kappa

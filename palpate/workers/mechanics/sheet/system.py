"""Forces and stiffness of a sheet under a problem's loads."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.mechanics.fem.problem.boundary_value_problem import (
    GRAVITY_MM_PER_S2,
    Constants,
    Problem,
)
from palpate.workers.mechanics.fem.problem.regions import nodes_in
from palpate.workers.mechanics.materials.base import Law
from palpate.workers.mechanics.materials.neo_hookean import NeoHookean
from palpate.workers.mechanics.materials.yeoh import Yeoh
from palpate.workers.mechanics.sheet.model import POINTS, SheetModel, shapes
from palpate.workers.mechanics.sheet.plane_stress import PlaneStress, plane_stress

# [i, j, k] is the sign of the permutation: (a x b)_i = CROSS_ijk a_j b_k.
CROSS = np.zeros((3, 3, 3))
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


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
        found = [name for name, given in refused.items() if given]
        if found:
            raise InputError(f"A sheet cannot be simulated with {', '.join(found)}: leave it out.")

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
        S = full(found.stress).reshape(*f.shape[:2], 2, 2) * self.stiffnesses[..., None, None]
        each = np.einsum("mqia,mqab,mqnb->mni", f, S, self.model.gradients, optimize=True)
        return self._at_nodes(each) + self.bed_n_per_mm * (x - self.model.nodes)

    def outer_n(self, x: FloatArray, part: float = 1.0) -> FloatArray:
        """Return a fraction of the load on each node, shape (n, 3)."""
        if not self.pressure_mpa.any():
            return part * self.dead_n
        f = self.tangents_of_plane(x)
        areas = np.cross(f[..., 0], f[..., 1]) * (self.model.areas / 3)[:, None, None]
        pushed = np.einsum("qn,mq,mqi->mni", shapes(POINTS), self.pressure_mpa, areas)
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
        S = full(response.stress).reshape(m, 3, 2, 2) * self.stiffnesses[..., None, None]
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
        first = np.einsum("ijl,mql,mqk->mqikj", CROSS, f[..., 1], g[..., 0], optimize=True)
        second = np.einsum("ilj,mql,mqk->mqikj", CROSS, f[..., 0], g[..., 1], optimize=True)
        N = shapes(POINTS)
        return np.einsum("qn,mq,mqikj->mnikj", N, weight, first + second, optimize=True)

    def _at_nodes(self, each: FloatArray) -> FloatArray:
        total = np.zeros_like(self.model.nodes)
        np.add.at(total, self.model.triangles, each)
        return total


def full(stress: FloatArray) -> FloatArray:
    """Return S11, S22 and S12 as matrices, (q, 3) to (q, 2, 2)."""
    return stress[:, [[0, 2], [2, 1]]]

"""Small bodies, as models of our solver and of others."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.mechanics.fem.boundary_value_problem import Constants
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from tests.reference.calculix import Material
from tests.workers.mechanics.fem.blocks import cube, level_of

SIDE_MM = 40.0


@dataclass(frozen=True, eq=False)
class Block:
    """A cube of 40 mm with a ball inside that is four times stiffer.

    Parameters
    ----------
    mesh : TetMesh
    inside : ndarray of bool, shape (m,)
        Mask of the elements of the ball.
    fat, gland : Constants
        Constants outside and inside the ball.
    """

    mesh: TetMesh
    inside: np.ndarray
    fat: Constants
    gland: Constants

    @property
    def constants(self) -> dict[Tissue, Constants]:
        """Return the constants by tissue, for a `Problem`."""
        return {Tissue.FAT: self.fat, Tissue.GLANDULAR: self.gland}

    @property
    def materials(self) -> tuple[Material, Material]:
        """Return the materials for CalculiX."""
        fat, gland = (
            Material(np.flatnonzero(where), c.mu_mpa, c.kappa_mpa, c.density_t_per_mm3)
            for where, c in ((~self.inside, self.fat), (self.inside, self.gland))
        )
        return fat, gland

    @cached_property
    def model(self) -> Model:
        """Return the model for `workers.mechanics.fem.body_equilibrium.solve`."""
        tissue = np.where(self.inside, Tissue.GLANDULAR, Tissue.FAT)
        return prepare(Hierarchy((level_of(self.mesh, tissue),)))

    def face(self, axis: int, at_mm: float) -> IntArray:
        """Return the nodes in a plane normal to `axis`."""
        return np.flatnonzero(np.abs(self.mesh.nodes[:, axis] - at_mm) < 1e-6)

    def triangles(self, axis: int, at_mm: float) -> IntArray:
        """Return the boundary triangles in that plane, shape (k, 3)."""
        t = self.mesh.tets
        sides = np.concatenate([np.delete(t, corner, axis=1) for corner in range(4)])
        flat = (np.abs(self.mesh.nodes[sides][:, :, axis] - at_mm) < 1e-6).all(axis=1)
        return sides[flat]

    def areas_mm2(self, triangles: IntArray) -> FloatArray:
        """Return the share of each node in the area of `triangles`, shape (n,)."""
        a, b, c = np.moveaxis(self.mesh.nodes[triangles], 1, 0)
        share = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        return np.bincount(triangles.ravel(), np.repeat(share, 3), len(self.mesh.nodes))


def block(young_mpa: float, cells: int = 8, poisson: float = 0.49) -> Block:
    """Return the block with its ball off the centre and its inner nodes moved at random."""
    mesh = cube(cells, side=SIDE_MM, jitter=0.2)
    centre = mesh.nodes[mesh.tets].mean(axis=1)
    inside = np.linalg.norm(centre - [18, 22, 20], axis=1) < 12
    return Block(mesh, inside, Constants(young_mpa, poisson), Constants(4 * young_mpa, poisson))


def half_ellipsoid(core: float) -> Volume:
    """Return a body with semi-axes of 40 x 30 x 30 mm, cut at the chest wall, 1 mm voxels.

    The same ellipsoid scaled by `core` is glandular.
    """
    x, y, z = np.arange(-39.5, 40), np.arange(-29.5, 30), np.arange(0.5, 30)
    radius = np.sqrt(
        (x[None, None] / 40) ** 2 + (y[None, :, None] / 30) ** 2 + (z[:, None, None] / 30) ** 2
    )
    labels = np.where(radius < 1, Tissue.FAT, Tissue.AIR)
    labels[radius < core] = Tissue.GLANDULAR
    return Volume(labels.astype(np.uint8), (1.0, 1.0, 1.0), (x[0], y[0], z[0]))

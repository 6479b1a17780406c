"""The body of an experiment: shape, mesh and arms of markers on its surface."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, IntArray, TetMesh, Triple, Volume
from palpate.workers.body.mesh.boundary import boundary_triangles
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.body.mesh.whole_body import mesh_whole_body
from palpate.workers.comparison.observation.point_interpolation import interpolation
from palpate.workers.diagnosis.outcome.pictures.edges import sharp_edges
from palpate.workers.diagnosis.problem.forward import Forward, Tetrahedra
from palpate.workers.mechanics.fem.elements.model import Model, prepare
from palpate.workers.mechanics.fem.problem.fields import Frame, frame_of
from palpate.workers.mechanics.fem.problem.regions import Box
from palpate.workers.organs.specimen.block import block
from palpate.workers.organs.specimen.load_cell_forces import TetrahedraWithCells
from palpate.workers.organs.specimen.load_cells import LoadCell
from palpate.workers.organs.specimen.problem import region_of
from palpate.workers.organs.specimen.readings.spec import FinitePoint
from palpate.workers.organs.specimen.spec import SpecimenSpec
from palpate.workers.organs.specimen.surface_normal import outward_normals

# A point farther from the mesh is not on this body.
FARTHEST_MM = 3.0
# Depth over which the rotation of the surface is computed, in elements.
ELEMENTS_DEEP = 2.0


class Body:
    """A block, or the body of a mesh file.

    Parameters
    ----------
    spec : SpecimenSpec
    voxels : Volume or None
        The body of a mesh file; None for a block. See `workers.organs.specimen.voxelised_mesh`.
    """

    def __init__(self, spec: SpecimenSpec, voxels: Volume | None) -> None:
        self.spec = spec
        self.voxels = voxels

    def mesh(self, nodes: int) -> Hierarchy:
        """Return nested meshes with about this many nodes.

        Raises
        ------
        InputError
            If there are too few nodes, or the file contains no body.
        """
        box = self.spec.body.box_mm
        if box is not None:
            return block(box, nodes, self.spec.tissue_of(next(iter(self.spec.materials))))
        return mesh_whole_body(self._volume, nodes=nodes)

    def model(self, nodes: int) -> Any:
        """Return a mesh of about this many nodes, prepared for the solver; see `mesh`."""
        return prepare(self.mesh(nodes))

    def frame(self, model: Any) -> Frame:
        """Return the box around the body."""
        return frame_of(model.finest.nodes)

    def at_points(self, model: Any, points_mm: FloatArray) -> csr_matrix:
        """Return the interpolation matrix from nodes to points, shape (k, n)."""
        return interpolation(_mesh_of(model), points_mm, FARTHEST_MM)

    def arms(
        self,
        model: Any,
        feet_mm: FloatArray,
        outward: Sequence[FinitePoint | None],
        names: Sequence[str],
    ) -> csr_matrix:
        """Return the matrix of the motion of arms on the surface; see `arms`."""
        return arms(_mesh_of(model), feet_mm, outward, names)

    def forward(self, cells: Sequence[LoadCell]) -> Forward:
        """Return the forward model of the body, with its load cells."""
        return TetrahedraWithCells(cells) if cells else Tetrahedra()

    def edges(self, model: Any) -> IntArray:
        """Return the sharp edges of the body as pairs of nodes, shape (e, 2)."""
        finest = model.finest
        return sharp_edges(finest.nodes, boundary_triangles(finest.elements.tets))

    @property
    def box_mm(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner, shape (3,) each."""
        if self.spec.body.box_mm is not None:
            return np.zeros(3), np.asarray(self.spec.body.box_mm, np.float64)
        low, high = self._voxels_box
        origin, step = np.asarray(self._volume.origin_mm), np.asarray(self._volume.spacing_mm)
        return origin + low * step, origin + high * step

    @property
    def wall_mm(self) -> float:
        """Lowest z."""
        return float(self.box_mm[0][2])

    @property
    def base_mm(self) -> Triple:
        """Approximate centre of the held regions or, if none is held, of the moved regions."""
        low, high = self.box_mm
        middles = []
        moved = (move.region for move in self.spec.states[0].moves)
        for region in [hold.region for hold in self.spec.holds] or moved:
            box = region_of(self.spec.regions[region])
            if not isinstance(box, Box):
                middles.append((low + high) / 2)
                continue
            ends = [np.clip(corner, low, high) for corner in (box.lower_mm, box.upper_mm)]
            middles.append((ends[0] + ends[1]) / 2)
        x, y, z = np.mean(middles, axis=0)
        return float(x), float(y), float(z)

    @cached_property
    def _voxels_box(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner of the body in voxels."""
        places = np.argwhere(self._volume.values)[:, ::-1]
        return places.min(axis=0) - 0.5, places.max(axis=0) + 0.5

    @property
    def _volume(self) -> Volume:
        """Voxels of a body from a file."""
        if self.voxels is None:
            raise AssertionError("a block has no voxels")
        return self.voxels


def _mesh_of(model: Model) -> TetMesh:
    return TetMesh(model.finest.nodes, model.finest.elements.tets)


def arms(
    mesh: TetMesh,
    feet_mm: FloatArray,
    outward: Sequence[FinitePoint | None],
    names: Sequence[str],
) -> csr_matrix:
    """Return the matrix of the motion of arm ends relative to their feet, shape (k, n).

    Arms are 1 mm long. A marker is glued to a patch and rotates with the material below it: the
    rotation is a difference over two elements along the normal, which also smooths the
    distortion of single elements by a load next to the marker.

    Parameters
    ----------
    mesh : TetMesh
        Mesh with n nodes.
    feet_mm : ndarray, shape (k, 3)
        Points of the surface on which the arms are fixed.
    outward : sequence
        Direction of each arm; None for the normal of the surface.
    names : sequence of str
        Names of the points, for messages.

    Raises
    ------
    InputError
        If a point is on an edge and has no given direction.
    """
    triangles = boundary_triangles(mesh.tets)
    normals = outward_normals(mesh.nodes, triangles, feet_mm, outward, names)
    corners = mesh.nodes[mesh.tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    depth = ELEMENTS_DEEP * float(np.cbrt(6 * volumes.mean()))
    below = interpolation(mesh, feet_mm - depth * normals, FARTHEST_MM)
    return csr_matrix((interpolation(mesh, feet_mm, FARTHEST_MM) - below) / depth)

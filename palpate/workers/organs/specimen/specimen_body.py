"""The body of an experiment, solid or a thin sheet: shape, mesh and arms of markers on it.

A marker's arm ends on the surface and turns with it; outward normals are those of the surface's
triangles.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Triple, Volume
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, mesh_whole_body
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.diagnosis.outcome.body_pictures import sharp_edges
from palpate.workers.diagnosis.problem.inverse_problem import Forward, Tetrahedra
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, frame_of
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box
from palpate.workers.mechanics.sheet_mesh import SheetModel, sheet_mesh
from palpate.workers.organs.specimen.block_lattice import block
from palpate.workers.organs.specimen.load_cells import LoadCell, SheetForward, TetrahedraWithCells
from palpate.workers.organs.specimen.specimen_body_keys import FinitePoint, SheetSpec
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec
from palpate.workers.organs.specimen.specimen_problem import region_of

# Faces as close as the nearest one, within this fraction of an element, touch the point.
TOUCH = 1e-3
# Normals more than 25 degrees from their mean are ambiguous.
ALIKE = 0.9


def outward_normals(
    nodes: FloatArray,
    triangles: IntArray,
    points: FloatArray,
    stated: Sequence[FinitePoint | None],
    names: Sequence[str],
) -> FloatArray:
    """Return unit normals at points of a surface, shape (k, 3).

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
    triangles : ndarray of int, shape (m, 3)
        Corners of the triangles, oriented outwards.
    points : ndarray, shape (k, 3)
    stated : sequence
        A direction for each point; None for the normal of the surface.
    names : sequence of str
        Names of the points, for the message.

    Raises
    ------
    InputError
        If a point on an edge, where the surface has no normal, has no given direction.
    """
    corners = nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-300)[:, None]
    near = TOUCH * float(np.sqrt(size.mean()))
    normals = []
    for point, direction, name in zip(points, stated, names, strict=True):
        if direction is not None:
            normals.append(np.asarray(direction) / np.linalg.norm(direction))
            continue
        away = distances_to_triangles(point, corners)
        there = normal[away <= away.min() + near]
        mean = there.sum(axis=0)
        mean = mean / max(float(np.linalg.norm(mean)), 1e-300)
        if (there @ mean).min() < ALIKE:
            raise InputError(
                f"The marker {name} is on an edge of the body, where the outward direction is "
                "ambiguous. Give its direction: outward: [x, y, z]."
            )
        normals.append(mean)
    return np.array(normals)


def distances_to_triangles(point: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the distances in mm of a point from triangles, corners of shape (m, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    to_plane = _to_inside(point, a, b, c)
    to_edges = [_to_segment(point, *ends) for ends in ((a, b), (b, c), (c, a))]
    return np.minimum(to_plane, np.min(to_edges, axis=0))


def _to_inside(point: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return the distance from the plane if the foot is inside the triangle, else infinity."""
    n = np.cross(b - a, c - a)
    square = np.maximum((n**2).sum(axis=1), 1e-300)
    u = (np.cross(point - a, c - a) * n).sum(axis=1) / square
    v = (np.cross(b - a, point - a) * n).sum(axis=1) / square
    height = np.abs(((point - a) * n).sum(axis=1)) / np.sqrt(square)
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1), height, np.inf)


def _to_segment(point: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip(((point - a) * along).sum(axis=1) / length, 0, 1)
    return np.asarray(np.linalg.norm(point - a - t[:, None] * along, axis=1))


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
        return interpolation_at_points(_mesh_of(model), points_mm, FARTHEST_MM)

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
    mesh: TetMesh, feet_mm: FloatArray, outward: Sequence[FinitePoint | None], names: Sequence[str]
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
    below = interpolation_at_points(mesh, feet_mm - depth * normals, FARTHEST_MM)
    return csr_matrix((interpolation_at_points(mesh, feet_mm, FARTHEST_MM) - below) / depth)


def body_of(spec: SpecimenSpec, voxels: Volume | None) -> Body:
    """Return the body of an experiment; see `Body`."""
    return SheetBody(spec, spec.body.sheet) if spec.body.sheet else Body(spec, voxels)


class SheetBody(Body):
    """A sheet at z = 0.

    Parameters
    ----------
    spec : SpecimenSpec
    sheet : SheetSpec
    """

    def __init__(self, spec: SpecimenSpec, sheet: SheetSpec) -> None:
        super().__init__(spec, None)
        self.outline_mm = np.array(sheet.corners_mm, np.float64)
        self.thickness_mm = sheet.thickness_mm

    @property
    def box_mm(self) -> tuple[FloatArray, FloatArray]:
        """See `Body.box_mm`."""
        low, high = self.outline_mm.min(axis=0), self.outline_mm.max(axis=0)
        return np.append(low, 0.0), np.append(high, 0.0)

    @property
    def wall_mm(self) -> float:
        """Always nan: a sheet has no wall."""
        return float("nan")

    def model(self, nodes: int) -> SheetModel:
        """See `Body.model`."""
        return sheet_mesh(self.outline_mm, self._borders(), nodes, self.thickness_mm)

    def frame(self, model: SheetModel) -> Frame:
        """See `Body.frame`."""
        return model.frame

    def at_points(self, model: SheetModel, points_mm: FloatArray) -> csr_matrix:
        """See `Body.at_points`."""
        return model.at_points(points_mm, FARTHEST_MM)

    def forward(self, cells: Sequence[LoadCell]) -> SheetForward:
        """See `Body.forward`."""
        return SheetForward(cells)

    def edges(self, model: SheetModel) -> IntArray:
        """See `Body.edges`."""
        return np.concatenate([model.border[:, [0, 2]], model.border[:, [2, 1]]])

    def _borders(self) -> Iterator[FloatArray]:
        """Yield the sides of all box regions, clipped to the surroundings of the sheet."""
        low, high = self.box_mm
        beyond = float(np.linalg.norm(high - low))
        for region in self.spec.regions.values():
            box = region_of(region)
            if not isinstance(box, Box):
                continue
            a = np.maximum(box.lower_mm, low - beyond)[:2]
            b = np.minimum(box.upper_mm, high + beyond)[:2]
            a, b = (np.round(corner, 2) for corner in (a, b))
            if (b > a).all() and box.lower_mm[2] <= 0 <= box.upper_mm[2]:
                corners = np.array([a, (b[0], a[1]), b, (a[0], b[1])])
                yield from np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)

"""Discretisation: geometry, graph and transfer of each mesh, and the state of one mesh.

A `Model` is computed once for a body and reused. The graph is the sparsity pattern of the tangent:
pairs of nodes that share an element. A `State` is that of a level at one stage of the loading, with
its history variables.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypedDict

import numpy as np
from numba import njit
from scipy import sparse

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.body.mesh.mesh_geometry import (
    boundary_triangles,
    nodal_areas_mm2,
    split_boundary,
    triangle_areas_mm2,
)
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, MeshLevel
from palpate.workers.kernels_and_threads import CONTRACTED, Float32Array
from palpate.workers.mechanics.fem.element_energy import Elements, shape_gradients
from palpate.workers.mechanics.fem.loads_and_regions import Device
from palpate.workers.mechanics.fem.membrane import Sheet, sheet_of
from palpate.workers.mechanics.fem.plate_contact import PENALTY_N_PER_MM3, PlateFriction
from palpate.workers.mechanics.fem.plate_surface import (
    ContactFaces,
    ContactNodes,
    Gap,
    PlateSurface,
    plate_surfaces,
)


@dataclass(frozen=True, eq=False)
class Graph:
    """Sparsity pattern of the tangent in compressed rows (CSR): nodes that share an element.

    Parameters
    ----------
    start : ndarray of int32, shape (n + 1,)
        Row i is ``neighbour[start[i]:start[i + 1]]``, ascending, i itself included.
    neighbour : ndarray of int32, shape (edges,)
    diagonal : ndarray of int32, shape (n,)
        Position of i in its own row.
    edge : ndarray of int32, shape (m, 4, 4)
        Row of ``neighbour`` for each ordered pair of nodes of each element.
    """

    start: IntArray
    neighbour: IntArray
    diagonal: IntArray
    edge: IntArray


def build_graph(n_nodes: int, tets: IntArray) -> Graph:
    """Build the graph of `tets`, shape (m, 4)."""
    start, neighbour = _rows(n_nodes, tets)
    edge = _edges(start, neighbour, tets)
    row = np.repeat(np.arange(n_nodes, dtype=np.int32), np.diff(start))
    diagonal = np.flatnonzero(row == neighbour).astype(np.int32)
    return Graph(start, neighbour, diagonal, edge)


@njit(**CONTRACTED)
def _rows(n_nodes: int, tets: IntArray) -> tuple[IntArray, IntArray]:
    """Return ``start`` and ``neighbour``; see `Graph`."""
    around = np.zeros(n_nodes + 1, np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            around[tets[e, a] + 1] += 1
    for n in range(n_nodes):
        around[n + 1] += around[n]
    place = around[:-1].copy()
    elements = np.empty(around[n_nodes], np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            n = tets[e, a]
            elements[place[n]] = e
            place[n] += 1
    start = np.zeros(n_nodes + 1, np.int32)
    visited = np.full(n_nodes, -1, np.int32)
    neighbour = np.empty(16 * n_nodes + 64, np.int32)
    filled = 0
    for n in range(n_nodes):
        first = filled
        for q in range(around[n], around[n + 1]):
            e = elements[q]
            for a in range(4):
                other = tets[e, a]
                if visited[other] != n:
                    visited[other] = n
                    if filled == neighbour.shape[0]:
                        grown = np.empty(2 * filled, np.int32)
                        grown[:filled] = neighbour
                        neighbour = grown
                    neighbour[filled] = other
                    filled += 1
        neighbour[first:filled].sort()
        start[n + 1] = filled
    return start, neighbour[:filled].copy()


@njit(**CONTRACTED)
def _edges(start: IntArray, neighbour: IntArray, tets: IntArray) -> IntArray:
    """Return the row of each ordered pair of nodes of each element, (m, 4, 4)."""
    edge = np.empty((tets.shape[0], 4, 4), np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            n = tets[e, a]
            for b in range(4):
                row = neighbour[start[n] : start[n + 1]]
                edge[e, a, b] = start[n] + np.searchsorted(row, tets[e, b])
    return edge


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer from and to the next coarser level.

    Parameters
    ----------
    exact : csr_matrix, shape (n, coarser n)
        Prolongation in double precision.
    prolongation, restriction : csr_matrix
        The prolongation and its transpose in single precision, for the V-cycle.
    """

    exact: sparse.csr_matrix
    prolongation: sparse.csr_matrix
    restriction: sparse.csr_matrix


@dataclass(frozen=True, eq=False)
class LevelModel:
    """One mesh of the hierarchy, prepared for any constants and loads.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
    elements : Elements
    nodal_volumes : ndarray, shape (n,)
        V_n, a quarter of the volume of the adjacent elements.
    fractions : ndarray, shape (m, tissues)
    wall : ndarray of int32, shape (w,)
    wall_areas : ndarray, shape (n,)
        Share of each node in the area of the chest wall, in mm^2.
    edge_mm : float
        Mean size of an element, the cube root of six times its volume.
    contact_nodes : ContactNodes
    sheet : Sheet
    sheet_edge : ndarray of int32, shape (k, 3, 3)
    transfer : Transfer or None
        None on the coarsest level.
    """

    nodes: FloatArray
    elements: Elements
    nodal_volumes: FloatArray
    fractions: FloatArray
    graph: Graph
    wall: IntArray
    wall_areas: FloatArray
    edge_mm: float
    contact_nodes: ContactNodes
    sheet: Sheet
    sheet_edge: IntArray
    transfer: Transfer | None

    @cached_property
    def centroids(self) -> FloatArray:
        """Centroids of the elements, shape (m, 3)."""
        return np.asarray(self.nodes[self.elements.tets].mean(axis=1))


@dataclass(frozen=True, eq=False)
class Model:
    """Levels of a body, coarse to fine."""

    levels: tuple[LevelModel, ...]

    def __iter__(self) -> Iterator[LevelModel]:
        return iter(self.levels)

    @property
    def finest(self) -> LevelModel:
        """Level whose displacement is the solution."""
        return self.levels[-1]


def prepare(hierarchy: Hierarchy) -> Model:
    """Prepare the data that candidates on the same mesh share."""
    return Model(tuple(_prepare_level(level) for level in hierarchy.levels))


def reshaped(model: Model, nodes: Sequence[FloatArray]) -> Model:
    """Return the same meshes with other undeformed nodes, one array per level."""
    levels = [
        replace(level, **_geometry(x, level.elements.tets, level.sheet.triangles, level.wall))
        for level, x in zip(model, nodes, strict=True)
    ]
    return Model(tuple(levels))


def _prepare_level(level: MeshLevel) -> LevelModel:
    """Prepare one level."""
    nodes = np.ascontiguousarray(level.mesh.nodes, dtype=np.float64)
    tets = np.ascontiguousarray(level.mesh.tets, dtype=np.int32)
    surface = np.ascontiguousarray(level.surface, dtype=np.int32)
    wall = np.asarray(level.wall, dtype=np.int32)
    graph = build_graph(len(nodes), tets)
    return LevelModel(
        **_geometry(nodes, tets, surface, wall),
        fractions=np.asarray(level.fractions, dtype=np.float64),
        graph=graph,
        wall=wall,
        sheet_edge=_sheet_edges(graph, surface),
        transfer=_transfer(level.prolongation),
    )


class _Geometry(TypedDict):
    """Part of a `LevelModel` that depends on the positions of the nodes."""

    nodes: FloatArray
    elements: Elements
    nodal_volumes: FloatArray
    wall_areas: FloatArray
    edge_mm: float
    contact_nodes: ContactNodes
    sheet: Sheet


def _geometry(nodes: FloatArray, tets: IntArray, surface: IntArray, wall: IntArray) -> _Geometry:
    """Compute elements, areas and volumes."""
    gradients, volumes = shape_gradients(nodes, tets)
    _, on_wall = split_boundary(boundary_triangles(tets), wall)
    return {
        "nodes": nodes,
        "elements": Elements(tets, gradients, volumes),
        "nodal_volumes": np.asarray(
            np.bincount(tets.ravel(), np.repeat(volumes / 4, 4), len(nodes)), dtype=np.float64
        ),
        "wall_areas": nodal_areas_mm2(nodes, on_wall),
        "edge_mm": float(np.cbrt(6 * volumes.mean())),
        "contact_nodes": _contact_nodes(nodes, surface),
        "sheet": sheet_of(nodes, surface),
    }


def _contact_nodes(nodes: FloatArray, surface: IntArray) -> ContactNodes:
    """Return the nodes of the free surface, and its triangles in their order."""
    areas = nodal_areas_mm2(nodes, surface)
    touching = np.flatnonzero(areas).astype(np.int32)
    corners = np.searchsorted(touching, surface).astype(np.int32)
    faces = ContactFaces(corners, triangle_areas_mm2(nodes, surface) * PENALTY_N_PER_MM3)
    return ContactNodes(touching, areas[touching] * PENALTY_N_PER_MM3, faces)


def _sheet_edges(graph: Graph, surface: IntArray) -> IntArray:
    """Return the row of the graph for each ordered pair of corners of each triangle."""
    n = len(graph.start) - 1
    row = np.repeat(np.arange(n, dtype=np.int64), np.diff(graph.start))
    key = row * n + graph.neighbour
    a = np.repeat(surface, 3, axis=1).astype(np.int64)
    b = np.tile(surface, (1, 3)).astype(np.int64)
    return np.searchsorted(key, a * n + b).astype(np.int32).reshape(-1, 3, 3)


def _transfer(prolongation: sparse.csr_matrix | None) -> Transfer | None:
    """Store the prolongation in both precisions, and its transpose."""
    if prolongation is None:
        return None
    single = prolongation.astype(np.float32)
    return Transfer(prolongation.tocsr(), single.tocsr(), single.T.tocsr())


@dataclass(frozen=True, eq=False)
class History:
    """History variables, on which an equilibrium depends in addition to positions and load.

    Friction and follower pressure have no energy. These forces are held while an energy is
    minimised; `Level.update_history` updates them.

    Parameters
    ----------
    friction : tuple of PlateFriction
        For the lower and the upper plate; empty without friction.
    follower_force : ndarray, shape (n, 3), optional
        Force of the full follower pressures, in N; None before the first update.
    eigenvector : ndarray of float32, shape (n, 4), optional
        Estimate of the stiffest mode of the smoothed tangent, which starts the next power
        iteration of the linear solver; it affects only the last digits.
    """

    friction: tuple[PlateFriction, ...] = ()
    follower_force: FloatArray | None = None
    eigenvector: Float32Array | None = None


@dataclass(frozen=True, eq=False)
class State:
    """Positions, travel of the plates, and history.

    Parameters
    ----------
    x : ndarray, shape (n, 3)
        Positions of the nodes in mm.
    travel_mm : float
        Closing distance of the plates.
    history : History
    """

    x: FloatArray
    travel_mm: float
    history: History = field(default_factory=History)

    def moved_to(self, x: FloatArray, travel_mm: float) -> "State":
        """Return a state at other positions with the same history."""
        return State(x, travel_mm, self.history)

    def moved_along(self, length: float, u: FloatArray, travel: float) -> "State":
        """Return the state after a fraction of a step, directions of friction included."""
        x, t = self.x + length * u, self.travel_mm + length * travel
        friction = tuple(
            f.with_direction_moved(length, self.x, self.travel_mm, u, travel)
            for f in self.history.friction
        )
        return State(x, t, replace(self.history, friction=friction))

    def with_free_directions(self) -> "State":
        """Return the state with the directions of friction as separate unknowns."""
        friction = tuple(
            replace(f, dual=f.direction(self.x, self.travel_mm)) for f in self.history.friction
        )
        return replace(self, history=replace(self.history, friction=friction))

    def with_directions_of_slip(self) -> "State":
        """Return the state with the directions of friction taken from its slips."""
        friction = tuple(replace(f, dual=None) for f in self.history.friction)
        return replace(self, history=replace(self.history, friction=friction))

    def with_eigenvector(self, eigenvector: Float32Array | None) -> "State":
        """Return the same state with another estimate of the stiffest mode."""
        return replace(self, history=replace(self.history, eigenvector=eigenvector))


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the loading.

    Parameters
    ----------
    gap : Gap or None
        Position of the plates at zero travel; None without plates.
    force_n : float or None
        Force on the plates; None where they stay at `gap`.
    fraction : float
        Fraction of the full gravity, forces, pressures and prescribed displacements.
    device : Device
    """

    gap: Gap | None
    force_n: float | None
    fraction: float
    device: Device

    def gap_at(self, travel_mm: float) -> Gap | None:
        """Return the positions of the plates along the axis after `travel_mm`."""
        if self.gap is None or self.force_n is None:
            return self.gap
        return self.gap.closed_by(travel_mm, self.device.lower_share)

    def plates(self, travel_mm: float) -> tuple[PlateSurface, ...]:
        """Return the plates after `travel_mm`."""
        gap = self.gap_at(travel_mm)
        return () if gap is None else plate_surfaces(self.device, gap)

"""Discretisation: geometry, graph and transfer of each mesh, computed once and reused."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypedDict

import numpy as np
from scipy import sparse

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.body.mesh.boundary import (
    boundary_triangles,
    nodal_areas_mm2,
    split_boundary,
    triangle_areas_mm2,
)
from palpate.workers.body.mesh.hierarchy import Hierarchy, MeshLevel
from palpate.workers.mechanics.fem.contact.contact_potential import ContactFaces, ContactNodes
from palpate.workers.mechanics.fem.contact.plates import PENALTY_N_PER_MM3
from palpate.workers.mechanics.fem.elements.element_energy import Elements, shape_gradients
from palpate.workers.mechanics.fem.elements.graph import Graph, build_graph
from palpate.workers.mechanics.fem.elements.membrane import Sheet, sheet_of


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

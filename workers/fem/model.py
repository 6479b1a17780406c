"""All that a mesh alone decides: geometry, graph and transfer, made once and reused."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from storage.values import FloatArray, IntArray
from workers.fem.contact import PENALTY_N_PER_MM3, Pads
from workers.fem.graph import Graph, build_graph
from workers.fem.kernels import Elements, shape_gradients
from workers.fem.membrane import Sheet, sheet_of
from workers.mesh.hierarchy import Hierarchy, MeshLevel
from workers.mesh.node_sets import boundary_triangles, nodal_areas_mm2, split_boundary


@dataclass(frozen=True, eq=False)
class Transfer:
    """Prolongation from the next coarser level, and its transpose, in single precision."""

    exact: sparse.csr_matrix
    down: sparse.csr_matrix
    up: sparse.csr_matrix


@dataclass(frozen=True, eq=False)
class LevelModel:
    """One mesh of the hierarchy, ready for any constants and loads.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
    elements : Elements
    nodal_volumes : ndarray, shape (n,)
        V_n, a quarter of the volume of each element around.
    fractions : ndarray, shape (m, tissues)
    wall : ndarray of int32, shape (w,)
    wall_areas : ndarray, shape (n,)
        Share of each node in the area of the chest wall, in mm^2.
    edge_mm : float
        Mean size of an element, the cube root of six of its volume.
    pads : Pads
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
    pads: Pads
    sheet: Sheet
    sheet_edge: IntArray
    transfer: Transfer | None


@dataclass(frozen=True, eq=False)
class Model:
    """The levels of a body, coarse to fine."""

    levels: tuple[LevelModel, ...]

    def __iter__(self) -> Iterator[LevelModel]:
        return iter(self.levels)

    @property
    def finest(self) -> LevelModel:
        """The level whose displacement is the answer."""
        return self.levels[-1]


def prepare(hierarchy: Hierarchy) -> Model:
    """Everything that candidates on the same mesh share."""
    return Model(tuple(_prepare_level(level) for level in hierarchy.levels))


def reshaped(model: Model, nodes: Sequence[FloatArray]) -> Model:
    """The same meshes with their undeformed nodes elsewhere, one array for each level."""
    levels = [
        replace(level, **_geometry(x, level.elements.tets, level.sheet.triangles, level.wall))
        for level, x in zip(model, nodes, strict=True)
    ]
    return Model(tuple(levels))


def _prepare_level(level: MeshLevel) -> LevelModel:
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


def _geometry(
    nodes: FloatArray, tets: IntArray, surface: IntArray, wall: IntArray
) -> dict[str, Any]:
    """What follows from the places of the nodes."""
    gradients, volumes = shape_gradients(nodes, tets)
    _, on_wall = split_boundary(boundary_triangles(tets), wall)
    share = nodal_areas_mm2(nodes, surface)
    pads = np.flatnonzero(share).astype(np.int32)
    return {
        "nodes": nodes,
        "elements": Elements(tets, gradients, volumes),
        "nodal_volumes": np.bincount(tets.ravel(), np.repeat(volumes / 4, 4), len(nodes)),
        "wall_areas": nodal_areas_mm2(nodes, on_wall),
        "edge_mm": float(np.cbrt(6 * volumes.mean())),
        "pads": Pads(pads, share[pads] * PENALTY_N_PER_MM3),
        "sheet": sheet_of(nodes, surface),
    }


def _sheet_edges(graph: Graph, surface: IntArray) -> IntArray:
    n = len(graph.start) - 1
    row = np.repeat(np.arange(n, dtype=np.int64), np.diff(graph.start))
    key = row * n + graph.neighbour
    a = np.repeat(surface, 3, axis=1).astype(np.int64)
    b = np.tile(surface, (1, 3)).astype(np.int64)
    return np.searchsorted(key, a * n + b).astype(np.int32).reshape(-1, 3, 3)


def _transfer(prolongation: sparse.csr_matrix | None) -> Transfer | None:
    if prolongation is None:
        return None
    down = prolongation.astype(np.float32)
    return Transfer(prolongation.tocsr(), down.tocsr(), down.T.tocsr())

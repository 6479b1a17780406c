"""All that a mesh alone decides: geometry, graph and transfer, made once and reused."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from storage.values import FloatArray, IntArray
from workers.fem.contact import PENALTY_N_PER_MM3, Pads
from workers.fem.graph import Graph, build_graph
from workers.fem.kernels import shape_gradients
from workers.fem.membrane import Sheet, sheet_of
from workers.mesh.hierarchy import Hierarchy, MeshLevel


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
    nodes : ndarray, shape (n, 3), and tets : ndarray of int32, shape (m, 4)
    gradients : ndarray, shape (m, 3, 3), and volumes : ndarray, shape (m,)
    nodal_volumes : ndarray, shape (n,)
        V_n, a quarter of the volume of each element around.
    fractions : ndarray, shape (m, tissues)
    wall : ndarray of int32, shape (w,)
    pads : Pads
    sheet : Sheet
    sheet_edge : ndarray of int32, shape (k, 3, 3)
    transfer : Transfer or None
        None on the coarsest level.
    """

    nodes: FloatArray
    tets: IntArray
    gradients: FloatArray
    volumes: FloatArray
    nodal_volumes: FloatArray
    fractions: FloatArray
    graph: Graph
    wall: IntArray
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


def _prepare_level(level: MeshLevel) -> LevelModel:
    nodes = np.ascontiguousarray(level.mesh.nodes, dtype=np.float64)
    tets = np.ascontiguousarray(level.mesh.tets, dtype=np.int32)
    surface = np.ascontiguousarray(level.surface, dtype=np.int32)
    gradients, volumes = shape_gradients(nodes, tets)
    graph = build_graph(len(nodes), tets)
    sheet = sheet_of(nodes, surface)
    return LevelModel(
        nodes=nodes,
        tets=tets,
        gradients=gradients,
        volumes=volumes,
        nodal_volumes=_nodal_sum(len(nodes), tets, volumes / 4),
        fractions=np.asarray(level.fractions, dtype=np.float64),
        graph=graph,
        wall=np.asarray(level.wall, dtype=np.int32),
        pads=_pads(len(nodes), surface, sheet.area),
        sheet=sheet,
        sheet_edge=_sheet_edges(graph, surface),
        transfer=_transfer(level.prolongation),
    )


def _pads(n: int, surface: IntArray, area: FloatArray) -> Pads:
    share = _nodal_sum(n, surface, area / 3)
    nodes = np.flatnonzero(share).astype(np.int32)
    return Pads(nodes, share[nodes] * PENALTY_N_PER_MM3)


def _nodal_sum(n: int, cells: IntArray, share: FloatArray) -> FloatArray:
    """Give each corner of each cell its share."""
    total = np.zeros(n)
    np.add.at(total, cells, share[:, None])
    return total


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

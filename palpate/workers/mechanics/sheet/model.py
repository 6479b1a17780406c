"""Mesh of a sheet: 6-node triangles, their shape functions, and interpolation."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.problem.fields import Frame

# Barycentric coordinates of the integration points, exact for polynomials of degree 2.
POINTS = np.full((3, 3), 1 / 6) + np.eye(3) / 2
# Corners at the ends of the edges, in the order of their midside nodes 3, 4 and 5.
EDGES = ((0, 1), (1, 2), (2, 0))
# Weights of corners and midside nodes for an even load on a triangle, and on an edge.
EVEN_AREA, EVEN_EDGE = (0.0, 1 / 3), (1 / 6, 2 / 3)
MOST_PAIRS = 2_000_000


@dataclass(frozen=True, eq=False)
class SheetModel:
    """Flat sheet at z = 0.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        In mm; corners first, then the middles of edges.
    triangles : ndarray of int, shape (m, 6)
        Three corners, counterclockwise, and the middles of edges 01, 12 and 20.
    thickness_mm : float
    """

    nodes: FloatArray
    triangles: IntArray
    thickness_mm: float

    @property
    def finest(self) -> "SheetModel":
        """The mesh itself: a sheet has only one."""
        return self

    @cached_property
    def frame(self) -> Frame:
        """Box around the sheet."""
        low, high = self.nodes[:, :2].min(axis=0), self.nodes[:, :2].max(axis=0)
        (x, y), (half_x, half_y) = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
        return Frame((x, y, 0.0), (half_x, half_y, self.thickness_mm / 2))

    @cached_property
    def size_mm(self) -> float:
        """Diagonal of the box around the sheet."""
        return float(np.linalg.norm(np.ptp(self.nodes, axis=0)))

    @cached_property
    def edge_mm(self) -> float:
        """Typical length of an edge of a triangle."""
        return float(np.sqrt(4 / np.sqrt(3) * self.areas.mean()))

    @cached_property
    def areas(self) -> FloatArray:
        """Area of each triangle, shape (m,), in mm^2."""
        a, b, c = (self.nodes[self.triangles[:, k], :2] for k in range(3))
        (ux, uy), (vx, vy) = (b - a).T, (c - a).T
        return np.asarray((ux * vy - uy * vx) / 2)

    @cached_property
    def gradients(self) -> FloatArray:
        """Derivatives of the shape functions at the integration points, (m, 3, 6, 2)."""
        corners = self.nodes[self.triangles[:, :3], :2]
        # Rows of the inverse are the gradients of the last two barycentric coordinates.
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        barycentric = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        return np.einsum("qnk,mkx->mqnx", shape_slopes(POINTS), barycentric)

    @cached_property
    def places(self) -> FloatArray:
        """Integration points, shape (m, 3, 3)."""
        return np.einsum("qn,mnx->mqx", shapes(POINTS), self.nodes[self.triangles])

    @cached_property
    def border(self) -> IntArray:
        """Edges of the outline: both ends and the middle, shape (b, 3)."""
        edges = np.concatenate([self.triangles[:, [*ends, 3 + k]] for k, ends in enumerate(EDGES)])
        _, first, count = np.unique(edges[:, 2], return_index=True, return_counts=True)
        return np.asarray(edges[first[count == 1]])

    def shares(self, inside: BoolArray) -> FloatArray:
        """Return the nodes' shares of a uniform load on a region, shape (n,), with sum 1.

        Parameters
        ----------
        inside : ndarray of bool, shape (n,)
            Nodes of the region. If they include no triangle, edges of the outline are loaded;
            without edges, single nodes share the load evenly.
        """
        found = np.zeros(len(self.nodes))
        whole = inside[self.triangles].all(axis=1)
        _add_even(found, self.triangles[whole], self.areas[whole], 3, EVEN_AREA)
        if not whole.any():
            edges = self.border[inside[self.border].all(axis=1)]
            along = self.nodes[edges[:, 1]] - self.nodes[edges[:, 0]]
            _add_even(found, edges, np.linalg.norm(along, axis=1), 2, EVEN_EDGE)
        if not found.any():
            found[inside] = 1.0
        return np.asarray(found / found.sum())

    def at_points(self, points: FloatArray, farthest_mm: float) -> csr_matrix:
        """Return the matrix from values at nodes to values at points, shape (k, n).

        Parameters
        ----------
        points : ndarray, shape (k, 3)
            In mm; points off the sheet are extrapolated from the nearest triangle.
        farthest_mm : float

        Raises
        ------
        InputError
            If a point is farther from the sheet than that.
        """
        corners = self.nodes[self.triangles[:, :3], :2]
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        triangle, barycentric = np.empty(len(points), np.int64), np.empty((len(points), 3))
        step = max(1, MOST_PAIRS // len(corners))
        for start in range(0, len(points), step):
            chosen = slice(start, start + step)
            away = points[chosen, None, :2] - corners[:, 0]
            last = np.einsum("mab,kmb->kma", inverse, away)
            every = np.concatenate([1 - last.sum(axis=2, keepdims=True), last], axis=2)
            best = every.min(axis=2).argmax(axis=1)
            triangle[chosen], barycentric[chosen] = best, every[np.arange(len(best)), best]
        nearest = np.maximum(barycentric, 0.0)
        nearest /= nearest.sum(axis=1, keepdims=True)
        foot = np.einsum("kc,kcx->kx", nearest, corners[triangle])
        miss = np.hypot(*(points[:, :2] - foot).T)
        if miss.max(initial=0.0) > farthest_mm:
            raise InputError(
                f"{int((miss > farthest_mm).sum())} of {len(points)} points are more than "
                f"{farthest_mm:g} mm outside the sheet, the farthest by {miss.max():.1f} mm. "
                "Check the outline of the sheet and the coordinate system of the points."
            )
        rows = np.repeat(np.arange(len(points)), 6)
        columns = self.triangles[triangle].ravel()
        weights = shapes(barycentric).ravel()
        return csr_matrix((weights, (rows, columns)), (len(points), len(self.nodes)))


def shapes(barycentric: FloatArray) -> FloatArray:
    """Return the six shape functions at points, (k, 3) to (k, 6)."""
    corners = barycentric * (2 * barycentric - 1)
    middles = [4 * barycentric[:, a] * barycentric[:, b] for a, b in EDGES]
    return np.column_stack([corners, *middles])


def shape_slopes(barycentric: FloatArray) -> FloatArray:
    """Return derivatives of the shape functions in the barycentric coordinates, (k, 6, 3)."""
    found = np.zeros((len(barycentric), 6, 3))
    for k in range(3):
        found[:, k, k] = 4 * barycentric[:, k] - 1
    for k, (a, b) in enumerate(EDGES):
        found[:, 3 + k, a], found[:, 3 + k, b] = 4 * barycentric[:, b], 4 * barycentric[:, a]
    return found


def _add_even(
    total: FloatArray,
    parts: IntArray,
    sizes: FloatArray,
    corners: int,
    weights: tuple[float, float],
) -> None:
    of_corner, of_middle = weights
    np.add.at(total, parts[:, :corners], of_corner * sizes[:, None])
    np.add.at(total, parts[:, corners:], of_middle * sizes[:, None])

"""Meshes of thin sheets: 6-node triangles inside an outline, and interpolation on them.

A sheet's mesh has edges along its outline and along the borders of loaded regions.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from scipy.sparse import csr_matrix
from scipy.spatial import Delaunay

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.triangles import TRIANGLE_EDGES, shape_slopes, shapes

# Barycentric coordinates of the integration points, exact for polynomials of degree 2.
INTEGRATION_POINTS = np.full((3, 3), 1 / 6) + np.eye(3) / 2
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
        return np.einsum("qnk,mkx->mqnx", shape_slopes(INTEGRATION_POINTS), barycentric)

    @cached_property
    def places(self) -> FloatArray:
        """Integration points, shape (m, 3, 3)."""
        return np.einsum("qn,mnx->mqx", shapes(INTEGRATION_POINTS), self.nodes[self.triangles])

    @cached_property
    def border(self) -> IntArray:
        """Edges of the outline: both ends and the middle, shape (b, 3)."""
        edges = np.concatenate(
            [self.triangles[:, [*ends, 3 + k]] for k, ends in enumerate(TRIANGLE_EDGES)]
        )
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
        shares = np.zeros(len(self.nodes))
        whole = inside[self.triangles].all(axis=1)
        _add_even(shares, self.triangles[whole], self.areas[whole], 3, EVEN_AREA)
        if not whole.any():
            edges = self.border[inside[self.border].all(axis=1)]
            along = self.nodes[edges[:, 1]] - self.nodes[edges[:, 0]]
            _add_even(shares, edges, np.linalg.norm(along, axis=1), 2, EVEN_EDGE)
        if not shares.any():
            shares[inside] = 1.0
        return np.asarray(shares / shares.sum())

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


# Least distance of lattice points from outlines and borders of regions, in edge lengths.
CLEAR = 0.6
# Least number of edges along the square root of the area.
FEWEST_EDGES = 4
# Triangles may differ from the outline by this fraction of its area.
MOST_OFF = 1e-6


def sheet_mesh(
    outline: FloatArray, lines: Iterable[FloatArray], nodes: int, thickness_mm: float
) -> SheetModel:
    """Mesh a flat sheet.

    Parameters
    ----------
    outline : ndarray, shape (p, 2)
        Corners of a polygon without self-intersections, in mm.
    lines : iterable of ndarray, shape (2, 2)
        Segments that edges of triangles must follow.
    nodes : int
        Approximate number of nodes.
    thickness_mm : float

    Raises
    ------
    InputError
        If there are too few nodes for the outline.
    """
    ends = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    polygon = shapely.Polygon(outline)
    area = float(polygon.area)
    if not area > 0:
        raise InputError("The outline of the sheet encloses no area: list its corners in order.")
    edge = float(np.sqrt(8 * area / (np.sqrt(3) * nodes)))
    least = int(8 / np.sqrt(3) * FEWEST_EDGES**2)
    if nodes < least:
        raise InputError(f"A mesh of {nodes} nodes is too coarse: ask for {least} or more.")
    whole = [*ends, *(np.asarray(line, np.float64) for line in lines)]
    pieces = [p for line in whole for p in _cut(line, whole)]
    kept = [p for p in pieces if _on_sheet(p, polygon, ends)]
    fixed = _unique(np.concatenate([_along(p, edge) for p in kept]), edge)
    points = np.concatenate([fixed, _lattice(polygon, np.array(kept), edge)])
    triangles = Delaunay(points).simplices.astype(np.int32)
    triangles = _counterclockwise(points, triangles, edge)
    triangles = triangles[shapely.contains_xy(polygon, points[triangles].mean(axis=1))]
    sheet = _quadratic(points, triangles, thickness_mm)
    if abs(sheet.areas.sum() / area - 1) > MOST_OFF:
        raise InputError(
            f"Triangles of {edge:.2g} mm do not fill the outline of the sheet: they cover "
            f"{sheet.areas.sum():.4g} of {area:.4g} mm2. Ask for more nodes, or check that the "
            "outline does not cross itself."
        )
    return sheet


def _cut(line: FloatArray, others: Iterable[FloatArray]) -> list[FloatArray]:
    """Return the pieces of a segment between its intersections with others."""
    a, along = line[0], line[1] - line[0]
    length2 = float(along @ along)
    cuts = [0.0, 1.0]
    for other in others:
        b, way = other[0], other[1] - other[0]
        cross = along[0] * way[1] - along[1] * way[0]
        if abs(cross) > 1e-12 * length2:
            t = ((b - a)[0] * way[1] - (b - a)[1] * way[0]) / cross
            s = ((b - a)[0] * along[1] - (b - a)[1] * along[0]) / cross
            cuts += [t] if -1e-9 <= s <= 1 + 1e-9 else []
        else:  # parallel: its ends, where they are on this one
            for end in other:
                off = abs((end - a)[0] * along[1] - (end - a)[1] * along[0])
                cuts += [float((end - a) @ along) / length2] if off < 1e-9 * length2 else []
    places = np.unique(np.clip(np.round(cuts, 9), 0, 1))
    return [np.stack([a + t * along, a + u * along]) for t, u in pairwise(places)]


def _on_sheet(piece: FloatArray, polygon: shapely.Polygon, ends: FloatArray) -> bool:
    middle = piece.mean(axis=0, keepdims=True)
    on_border = float(_distance(middle, ends)[0]) < 1e-9 * float(np.ptp(ends))
    return on_border or bool(shapely.contains_xy(polygon, middle)[0])


def _along(piece: FloatArray, edge: float) -> FloatArray:
    count = max(1, round(float(np.linalg.norm(piece[1] - piece[0])) / edge))
    return np.asarray(piece[0] + np.linspace(0, 1, count + 1)[:, None] * (piece[1] - piece[0]))


def _unique(points: FloatArray, edge: float) -> FloatArray:
    """Return points without duplicates from shared ends of pieces."""
    _, first = np.unique(np.round(points / (1e-6 * edge)), axis=0, return_index=True)
    return np.asarray(points[np.sort(first)])


def _lattice(polygon: shapely.Polygon, pieces: FloatArray, edge: float) -> FloatArray:
    """Return points of a lattice of equilateral triangles inside, at a distance from all pieces."""
    low, high = np.reshape(polygon.bounds, (2, 2))
    rows = np.arange(low[1], high[1] + edge, edge * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0] + edge, edge)
    x, y = np.meshgrid(columns, rows)
    x = x + (np.arange(len(rows)) % 2)[:, None] * edge / 2
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.contains_xy(polygon, points)]
    return np.asarray(points[_distance(points, pieces) > CLEAR * edge])


def _distance(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Return the distance of points, (k, 2), from the nearest of the segments, (s, 2, 2)."""
    found = np.full(len(points), np.inf)
    for a, b in segments:
        along = b - a
        t = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0, 1)
        found = np.minimum(found, np.hypot(*(points - a - t[:, None] * along).T))
    return found


def _counterclockwise(points: FloatArray, triangles: IntArray, edge: float) -> IntArray:
    """Return triangles of uniform orientation, without degenerate ones."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    doubled = ux * vy - uy * vx
    turned = np.where((doubled < 0)[:, None], triangles[:, [0, 2, 1]], triangles)
    return turned[np.abs(doubled) > 1e-8 * edge**2].astype(np.int32)


def _quadratic(points: FloatArray, triangles: IntArray, thickness_mm: float) -> SheetModel:
    """Add a node in the middle of each edge, and drop points without a triangle."""
    used, corners = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], corners.reshape(-1, 3).astype(np.int32)
    edges = np.concatenate([np.sort(triangles[:, ends], axis=1) for ends in TRIANGLE_EDGES])
    pairs, number = np.unique(edges, axis=0, return_inverse=True)
    middles = (number.reshape(3, -1).T + len(points)).astype(np.int32)
    plane = np.concatenate([points, points[pairs].mean(axis=1)])
    nodes = np.column_stack([plane, np.zeros(len(plane))])
    return SheetModel(nodes, np.concatenate([triangles, middles], axis=1), thickness_mm)

"""Meshes of an outline, with edges along the borders of loaded regions."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.sheet.model import EDGES, SheetModel

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
    area = polygon_area(outline)
    if not area > 0:
        raise InputError("The outline of the sheet encloses no area: list its corners in order.")
    edge = float(np.sqrt(8 * area / (np.sqrt(3) * nodes)))
    least = int(8 / np.sqrt(3) * FEWEST_EDGES**2)
    if nodes < least:
        raise InputError(f"A mesh of {nodes} nodes is too coarse: ask for {least} or more.")
    whole = [*ends, *(np.asarray(line, np.float64) for line in lines)]
    pieces = [p for line in whole for p in _cut(line, whole)]
    kept = [p for p in pieces if _on_sheet(p, outline, ends)]
    fixed = _unique(np.concatenate([_along(p, edge) for p in kept]), edge)
    points = np.concatenate([fixed, _lattice(outline, np.array(kept), edge)])
    triangles = Delaunay(points).simplices.astype(np.int32)
    triangles = _counterclockwise(points, triangles, edge)
    triangles = triangles[_inside(points[triangles].mean(axis=1), outline)]
    found = _quadratic(points, triangles, thickness_mm)
    if abs(found.areas.sum() / area - 1) > MOST_OFF:
        raise InputError(
            f"Triangles of {edge:.2g} mm do not fill the outline of the sheet: they cover "
            f"{found.areas.sum():.4g} of {area:.4g} mm2. Ask for more nodes, or check that the "
            "outline does not cross itself."
        )
    return found


def polygon_area(outline: FloatArray) -> float:
    """Return the area of a polygon, shape (p, 2), of either orientation."""
    x, y = outline.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


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


def _on_sheet(piece: FloatArray, outline: FloatArray, ends: FloatArray) -> bool:
    middle = piece.mean(axis=0, keepdims=True)
    on_border = float(_distance(middle, ends)[0]) < 1e-9 * float(np.ptp(outline))
    return on_border or bool(_inside(middle, outline)[0])


def _along(piece: FloatArray, edge: float) -> FloatArray:
    count = max(1, round(float(np.linalg.norm(piece[1] - piece[0])) / edge))
    return np.asarray(piece[0] + np.linspace(0, 1, count + 1)[:, None] * (piece[1] - piece[0]))


def _unique(points: FloatArray, edge: float) -> FloatArray:
    """Return points without duplicates from shared ends of pieces."""
    _, first = np.unique(np.round(points / (1e-6 * edge)), axis=0, return_index=True)
    return np.asarray(points[np.sort(first)])


def _lattice(outline: FloatArray, pieces: FloatArray, edge: float) -> FloatArray:
    """Return points of a lattice of equilateral triangles inside, at a distance from all pieces."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1], high[1] + edge, edge * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0] + edge, edge)
    x, y = np.meshgrid(columns, rows)
    x = x + (np.arange(len(rows)) % 2)[:, None] * edge / 2
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[_inside(points, outline)]
    return np.asarray(points[_distance(points, pieces) > CLEAR * edge])


def _distance(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Return the distance of points, (k, 2), from the nearest of the segments, (s, 2, 2)."""
    found = np.full(len(points), np.inf)
    for a, b in segments:
        along = b - a
        t = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0, 1)
        found = np.minimum(found, np.hypot(*(points - a - t[:, None] * along).T))
    return found


def _inside(points: FloatArray, outline: FloatArray) -> BoolArray:
    """Test whether points are in a polygon: a ray from each crosses it an odd number of times."""
    found = np.zeros(len(points), np.bool_)
    x, y = points.T
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if ay != by:
            crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
            found ^= crosses
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
    edges = np.concatenate([np.sort(triangles[:, ends], axis=1) for ends in EDGES])
    pairs, number = np.unique(edges, axis=0, return_inverse=True)
    middles = (number.reshape(3, -1).T + len(points)).astype(np.int32)
    plane = np.concatenate([points, points[pairs].mean(axis=1)])
    nodes = np.column_stack([plane, np.zeros(len(plane))])
    return SheetModel(nodes, np.concatenate([triangles, middles], axis=1), thickness_mm)

"""Fitting of tetrahedra to the surface between one tissue and the others, both sides kept.

The surface is a smooth field. As for the outline of the body, the fraction of the tissue in a
voxel is blurred and converted to a distance by the inverse of the normal distribution (see
`workers.body.mesh.body_outline`). Near nodes move onto the surface, remaining crossings are cut.

This is `isosurface_stuffing` with the tetrahedra of both sides kept: the diagonals of cut faces
start at the deeper node, so that both sides agree.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.body_outline import SATURATION, Outline, distance_at
from palpate.workers.body.mesh.isosurface_stuffing import add_one_side, fit_to_surface
from palpate.workers.kernels_and_threads import EXACT

# Standard deviation of the blur in samples: less leaves a staircase of voxels, more
# closes the gaps between neighbouring compartments.
BLUR = 0.6
MARGIN = 2


@dataclass(frozen=True, eq=False)
class LevelSet:
    """Signed distance to a surface, linear near it and constant far from it.

    Parameters
    ----------
    field : ndarray of float32, shape (nz, ny, nx)
        In mm, negative in the tissue.
    frame : ndarray, shape (2, 3)
        Position of ``field[0, 0, 0]`` and distance of the samples along x, y, z.
    volume_mm3 : float
        Volume of the tissue's voxels.
    """

    field: NDArray[np.float32]
    frame: FloatArray
    volume_mm3: float


def level_set_of(labels: Volume, tissue: Tissue, blur: float = BLUR) -> LevelSet:
    """Return the level set of the voxels of one tissue, with a sample at each voxel.

    The tissue is continued straight through the plane of the chest wall.

    Parameters
    ----------
    labels : Volume
    tissue : Tissue
    blur : float
        Standard deviation in voxels of the coarsest axis.
    """
    inside = labels.values == tissue
    spacing = np.asarray(labels.spacing_mm, np.float64)
    sigma = blur * float(spacing.max())
    part = np.pad(inside.astype(np.float32), ((0, MARGIN), (MARGIN, MARGIN), (MARGIN, MARGIN)))
    for axis, length in zip((0, 1, 2), spacing[::-1], strict=True):
        part = ndimage.gaussian_filter1d(part, sigma / length, axis=axis, mode="nearest")
    spread = _spread(blur) * float(spacing.max())
    field = np.full(part.shape, spread * -ndtri(SATURATION), np.float32)
    field[part > 0.5] *= -1
    band = (part > SATURATION) & (part < 1 - SATURATION)
    field[band] = -spread * ndtri(part[band])
    origin = np.asarray(labels.origin_mm) - np.array([MARGIN, MARGIN, 0]) * spacing
    return LevelSet(
        field, np.array([origin, spacing]), float(np.count_nonzero(inside) * labels.voxel_mm3)
    )


def _spread(blur: float) -> float:
    """Return the deviation in voxels that puts voxel centres half a voxel from a plane surface."""
    step = np.repeat((0.0, 1.0), 32)
    beside = ndimage.gaussian_filter1d(step, blur, mode="nearest")[32]
    return float(0.5 / ndtri(beside))


@dataclass(frozen=True, eq=False)
class Cut:
    """A mesh fitted to a surface.

    Parameters
    ----------
    mesh : TetMesh
        Positively oriented. Its first nodes are the nodes of the original mesh.
    inside : ndarray of bool, shape (m,)
        Tetrahedra on the negative side.
    on_surface : ndarray of bool, shape (n,)
    parent : ndarray of int32, shape (m,)
        The original tetrahedron of each part.
    new_ends : ndarray of int32, shape (k, 2)
        Ends of the edges that contain the last k nodes.
    """

    mesh: TetMesh
    inside: BoolArray
    on_surface: BoolArray
    parent: IntArray
    new_ends: IntArray


def cut(
    mesh: TetMesh,
    size_mm: FloatArray,
    surface: LevelSet | Outline,
    level_mm: float,
    fixed: BoolArray,
    on_wall: BoolArray,
) -> Cut:
    """Fit a mesh to a level of a field.

    Parameters
    ----------
    mesh : TetMesh
    size_mm : ndarray, shape (m,)
        Size of the lattice around each tetrahedron.
    surface : LevelSet or Outline
    level_mm : float
        Value of the field on the surface.
    fixed : ndarray of bool, shape (n,)
        Nodes that must not move.
    on_wall : ndarray of bool, shape (n,)
        Nodes that stay at their z.
    """
    field, frame = surface.field, surface.frame
    distance = _at_nodes(mesh.nodes, field, frame) - level_mm
    lattice_mm = np.full(len(mesh.nodes), np.inf)
    np.minimum.at(lattice_mm, mesh.tets.ravel(), np.repeat(size_mm, 4))
    fitted = fit_to_surface(
        mesh, distance, lattice_mm, fixed, on_wall, field, frame, level_mm, both_sides=True
    )
    nodes, edges, points = fitted.nodes, fitted.edges, slice(len(distance), None)
    both_on_wall = on_wall[edges].all(axis=1)
    nodes[points, 2] = np.where(both_on_wall, mesh.nodes[edges[:, 0], 2], nodes[points, 2])
    tets, inside, parent = _both_sides(
        mesh.tets, nodes, fitted.distance, edges, fitted.start, fitted.incident, field, frame,
        level_mm,
    )  # fmt: skip
    on = np.concatenate([fitted.distance == 0, np.ones(len(edges), np.bool_)])
    return Cut(TetMesh(nodes, tets), inside, on, parent, edges)


@njit(**EXACT)
def _at_nodes(nodes: FloatArray, field: NDArray[np.float32], frame: FloatArray) -> FloatArray:
    found = np.empty(len(nodes))
    for v in range(len(nodes)):
        found[v] = distance_at(field, frame, nodes[v, 0], nodes[v, 1], nodes[v, 2])
    return found


@njit(**EXACT)
def _both_sides(
    tets: IntArray,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
) -> tuple[IntArray, BoolArray, IntArray]:
    room = len(tets)
    for m in range(len(tets)):
        low = high = 0
        for c in range(4):
            low += distance[tets[m, c]] < 0
            high += distance[tets[m, c]] > 0
        if low and high:
            room += 5
    parts = np.empty((room, 4), np.int32)
    inside, parent = np.empty(room, np.bool_), np.empty(room, np.int32)
    count = 0
    for m in range(len(tets)):
        tet = tets[m]
        before = count
        if distance[tet[0]] == distance[tet[1]] == distance[tet[2]] == distance[tet[3]] == 0:
            x = (nodes[tet[0]] + nodes[tet[1]] + nodes[tet[2]] + nodes[tet[3]]) / 4
            parts[count] = tet
            inside[count] = distance_at(field, frame, x[0], x[1], x[2]) < level
            parent[count] = m
            count += 1
            continue
        for side in range(2):
            sign = 1.0 - 2.0 * side
            count = add_one_side(
                parts, count, tet, sign, nodes, distance, edges, start, incident, True
            )
            for new in range(before, count):
                inside[new] = side == 0
                parent[new] = m
            before = count
    return parts[:count].copy(), inside[:count].copy(), parent[:count].copy()

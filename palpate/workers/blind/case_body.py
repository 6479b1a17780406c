r"""The body of a case: voxels, mesh, points on its true interfaces, and segmented scans.

The mesh has quadratic tetrahedra. Material points on the true interfaces move with the tissue; the
truth is known there.

A scan is voxel labels with segmentation errors. A blurred label is the normal distribution function
of the distance to its boundary, so :math:`d = \sigma \Phi^{-1}(v)` gives the distance to within
less than a voxel. The boundary is moved along its normal by a random field with two correlation
lengths.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree
from scipy.special import ndtri
from skimage.measure import marching_cubes

from palpate.storage.values import FloatArray, IntArray, Tissue, Volume
from palpate.workers.blind.breast_scene import Anatomy
from palpate.workers.blind.solver.quadratic_mesh import (
    EDGES,
    FACE_EDGES,
    FineMesh,
    QuadraticMesh,
    face_areas,
    quadratic,
)
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.comparison.warp_volume import warp_grey

SPACING_MM = 0.8
CORNERS = 2000  # of the tetrahedra; about 14,000 nodes including mid-edge nodes


@dataclass(frozen=True, eq=False)
class Body:
    """The labels of the undeformed body and its mesh."""

    labels: Volume
    mesh: QuadraticMesh


def body_of(anatomy: Anatomy, corners: int = CORNERS, spacing_mm: float = SPACING_MM) -> Body:
    """Generate and mesh a body of fat and glandular tissue.

    Parameters
    ----------
    anatomy : Anatomy
    corners : int
        Desired number of corner nodes, met within 10 %.
    spacing_mm : float
        Edge of the voxels.

    Raises
    ------
    InputError
        If the anatomy or the sizes are invalid.
    """
    settings = BreastPhantom(
        lower_mm=anatomy.lower_mm,
        upper_mm=anatomy.upper_mm,
        half_width_mm=anatomy.half_width_mm,
        depth_mm=anatomy.depth_mm,
        spacing_mm=spacing_mm,
        glandular_fraction=anatomy.glandular_fraction,
        skin_mm=0.0,
        ligament_mm=0.0,
        compartments=anatomy.compartments,
    )
    labels = generate_breast(settings, anatomy.seed).labels
    mesh = build_hierarchy(labels, nodes=corners).finest.mesh
    return Body(labels, quadratic(mesh.nodes, mesh.tets, 0.0))


OUTLINE, GLANDULAR = 0, 1
WALL_MARGIN_MM = 4.0
NEAREST_ELEMENTS = 40  # elements tried for each point


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """Set of k points that move with the tissue.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Positions in the undeformed body, in mm.
    interface : ndarray of int32, shape (k,)
        `OUTLINE` or `GLANDULAR`.
    nodes : ndarray of int32, shape (k, 10)
    weights : ndarray, shape (k, 10)
        Weights of the nodes; a point's displacement is the weighted sum over its nodes.
    """

    points: FloatArray
    interface: IntArray
    nodes: IntArray
    weights: FloatArray

    def moved(self, displacement_mm: FloatArray) -> FloatArray:
        """Return the displacements (k, 3) of the points, given nodal displacements (n, 3)."""
        return np.asarray(np.einsum("ka,kai->ki", self.weights, displacement_mm[self.nodes]))


def points_on(mesh: QuadraticMesh, labels: Volume, count: int, seed: int) -> MaterialPoints:
    """Spread points over the outline and over the boundary of the glandular tissue.

    Parameters
    ----------
    mesh : QuadraticMesh
    labels : Volume
        `Tissue` labels of the undeformed body.
    count : int
        Number of points on each of the two; points outside all elements, or within 4 mm of the
        chest wall, are then dropped.
    seed : int
    """
    rng = np.random.default_rng(seed)
    outline = _on_outline(mesh, count, rng)
    gland = _on_gland(mesh, labels, count, rng)
    parts = [p for p in (outline, gland) if len(p.points)]
    return MaterialPoints(
        *(
            np.concatenate([getattr(p, name) for p in parts])
            for name in ("points", "interface", "nodes", "weights")
        )
    )


def _on_outline(mesh: QuadraticMesh, count: int, rng: np.random.Generator) -> MaterialPoints:
    areas = face_areas(mesh, mesh.skin)
    faces = mesh.skin[rng.choice(len(areas), 2 * count, p=areas / areas.sum())]
    L = rng.dirichlet((1.0, 1.0, 1.0), 2 * count)
    points = np.einsum("ka,kai->ki", L, mesh.nodes[faces[:, :3]])
    kept = np.flatnonzero(points[:, 2] > WALL_MARGIN_MM)[:count]
    faces, L = faces[kept], L[kept]
    middle = 4 * L[:, FACE_EDGES[:, 0]] * L[:, FACE_EDGES[:, 1]]
    weights = np.hstack([L * (2 * L - 1), middle, np.zeros((len(kept), 4))])
    nodes = np.hstack([faces, np.repeat(faces[:, :1], 4, axis=1)])
    return MaterialPoints(points[kept], np.full(len(kept), OUTLINE, np.int32), nodes, weights)


def _on_gland(
    mesh: QuadraticMesh, labels: Volume, count: int, rng: np.random.Generator
) -> MaterialPoints:
    share = ndimage.gaussian_filter((labels.values == Tissue.GLANDULAR).astype(np.float32), 0.8)
    vertices, triangles, _, _ = marching_cubes(share, 0.5)
    corners = vertices[:, ::-1][triangles] * labels.spacing_mm + labels.origin_mm
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(sides, axis=1)
    drawn = corners[rng.choice(len(areas), 2 * count, p=areas / areas.sum())]
    points = np.einsum("ka,kai->ki", rng.dirichlet((1.0, 1.0, 1.0), 2 * count), drawn)
    points = points[points[:, 2] > WALL_MARGIN_MM]
    cells, L = locate(mesh, points)
    kept = np.flatnonzero(cells >= 0)[:count]
    L = L[kept]
    weights = np.hstack([L * (2 * L - 1), 4 * L[:, EDGES[:, 0]] * L[:, EDGES[:, 1]]])
    which = np.full(len(kept), GLANDULAR, np.int32)
    return MaterialPoints(points[kept], which, mesh.cells[cells[kept]], weights)


def locate(mesh: QuadraticMesh, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find the element of each point (k, 3), -1 outside, and barycentric coordinates (k, 4)."""
    corners = mesh.nodes[mesh.cells[:, :4]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    tries = list(range(1, min(NEAREST_ELEMENTS, len(corners)) + 1))
    near = np.asarray(KDTree(corners.mean(axis=1)).query(points, k=tries)[1])
    away = points[:, None] - corners[near, 0]
    last = np.einsum("kcij,kcj->kci", inverse[near], away)
    L = np.concatenate([1 - last.sum(axis=2, keepdims=True), last], axis=2)
    best = L.min(axis=2).argmax(axis=1)
    row = np.arange(len(points))
    L, cells = L[row, best], near[row, best]
    return np.where(L.min(axis=1) > -1e-9, cells, -1).astype(np.int32), L


BLUR_VOXELS = 0.8
MARGIN_MM = 6.0
# Half of the variance each; together similar to a single length of 4 mm.
LENGTHS_MM = (3.4, 4.8)
PIECE_RADIUS_MM = (3.0, 5.0)
# Fraction of a boundary's scatter left after voxels of 0.8 mm and the blur of an observer.
KEPT = 0.93


@dataclass(frozen=True, slots=True)
class Segmenter:
    """Errors of a segmentation.

    Parameters
    ----------
    sd_mm : float
        Scatter of the boundaries along their normals.
    outline_mm, glandular_mm : float
        Distances by which all labels, and the glandular ones, extend too far.
    ln_at_wall : float
        ln of the ratio of the scatter at the chest wall to the scatter at the nipple.
    pieces : int
        Number of pieces of gland missed, and also of pieces added.
    """

    sd_mm: float
    outline_mm: float = 0.0
    glandular_mm: float = 0.0
    ln_at_wall: float = 0.0
    pieces: int = 0


def glandular_share(labels: Volume) -> Volume:
    """Blur glandular labels to 0.5 at their boundary, with air assigned to the nearest tissue.

    With a margin around the labels, the elements alone determine the extent of a deformed body. If
    the voxels cut it too, it would lose about a tenth of a voxel all around.
    """
    wide = padded(labels, MARGIN_MM)
    _, (z, y, x) = ndimage.distance_transform_edt(
        wide.values == Tissue.AIR, sampling=labels.spacing_mm[::-1], return_indices=True
    )
    gland = (wide.values[z, y, x] == Tissue.GLANDULAR).astype(np.float32)
    share = ndimage.gaussian_filter(gland, BLUR_VOXELS)
    return replace(wide, values=share)


def deformed_labels(share: Volume, fine: FineMesh, displacement_mm: FloatArray) -> Volume:
    """Label the body under a displacement of its quadratic nodes, surrounded by air.

    Parameters
    ----------
    share : Volume
        Glandular share of the undeformed body, from `glandular_share`.
    fine : FineMesh
    displacement_mm : ndarray, shape (n, 3)
    """
    moved = warp_grey(share, fine.mesh, fine.interpolation @ displacement_mm, outside=-1.0)
    values = np.where(moved.values > 0.5, Tissue.GLANDULAR, Tissue.FAT).astype(np.uint8)
    values[moved.values < -0.5] = Tissue.AIR
    return padded(replace(moved, values=values), MARGIN_MM)


def padded(labels: Volume, margin_mm: float) -> Volume:
    """Add air on all sides."""
    count = int(np.ceil(margin_mm / min(labels.spacing_mm)))
    origin = np.asarray(labels.origin_mm) - count * np.asarray(labels.spacing_mm)
    x, y, z = map(float, origin)
    return replace(labels, values=np.pad(labels.values, count), origin_mm=(x, y, z))


def segmented(labels: Volume, segmenter: Segmenter, rng: np.random.Generator) -> Volume:
    """Segment the labels again, with errors.

    Parameters
    ----------
    labels : Volume
        Fat and glandular tissue surrounded by air; the body's end at the chest wall is a cut, which
        stays straight.
    segmenter : Segmenter
    rng : numpy Generator

    Returns
    -------
    Volume of uint8
        0 background, 1 fat, 2 glandular.
    """
    first = int(np.flatnonzero((labels.values != Tissue.AIR).any(axis=(1, 2)))[0])
    above = labels.values[first:]
    body = _redrawn(above != Tissue.AIR, labels.spacing_mm, segmenter, segmenter.outline_mm, rng)
    gland = _redrawn(
        above == Tissue.GLANDULAR, labels.spacing_mm, segmenter, segmenter.glandular_mm, rng
    )
    for _ in range(segmenter.pieces):
        gland &= ~_piece(gland, labels.spacing_mm, rng)
        gland |= _piece(body & ~gland, labels.spacing_mm, rng)
    drawn = np.where(gland, Tissue.GLANDULAR, Tissue.FAT) * body
    values = np.zeros(labels.values.shape, np.uint8)
    values[first:] = drawn
    return replace(labels, values=values)


def _redrawn(
    inside: NDArray[np.bool_],
    spacing_mm: tuple[float, float, float],
    segmenter: Segmenter,
    offset_mm: float,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Return the voxels inside the boundary after moving it outwards by an offset and noise."""
    # "nearest" continues the body straight through the cut at the chest wall.
    share = ndimage.gaussian_filter(inside.astype(np.float32), BLUR_VOXELS, mode="nearest")
    depth = BLUR_VOXELS * min(spacing_mm) * ndtri(np.clip(share, 1e-6, 1 - 1e-6))
    towards_wall = np.linspace(0.5, -0.5, len(inside))[:, None, None]
    sd_mm = segmenter.sd_mm / KEPT * np.exp(segmenter.ln_at_wall * towards_wall)
    return np.asarray(depth + offset_mm + sd_mm * _waves(inside.shape, spacing_mm, rng) > 0)


def _piece(
    inside: NDArray[np.bool_], spacing_mm: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return the voxels of a ball somewhere inside a tissue."""
    places = np.argwhere(inside)
    z, y, x = places[rng.integers(len(places))]
    radius_mm = rng.uniform(*PIECE_RADIUS_MM)
    step = np.asarray(spacing_mm)[::-1]
    grid = np.ogrid[tuple(slice(0, n) for n in inside.shape)]
    away = sum(((g - c) * s) ** 2 for g, c, s in zip(grid, (z, y, x), step, strict=True))
    return np.asarray(away < radius_mm**2)


def _waves(
    shape: tuple[int, ...], spacing_mm: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw a random field of variance 1, shape [z, y, x]."""
    total = np.zeros(shape, np.float32)
    for length in LENGTHS_MM:
        widths = length / np.sqrt(2) / np.asarray(spacing_mm)[::-1]
        field = ndimage.gaussian_filter(rng.standard_normal(shape, np.float32), widths, mode="wrap")
        total += field / (np.sqrt(len(LENGTHS_MM)) * field.std())
    return total

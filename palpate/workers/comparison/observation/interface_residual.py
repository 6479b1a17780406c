"""Material points on tissue interfaces of a reference scan, and residuals of the moved points.

A residual is the signed distance, with subvoxel accuracy, of a moved material point to its
interface in a deformed scan.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Tissue, Triple, Volume
from palpate.workers.comparison.observation.isosurface import (
    LEVEL,
    SMOOTH_VOXELS,
    Surface,
    cubic_at_points,
    surface,
)
from palpate.workers.comparison.observation.triangle_distance import distances


@dataclass(frozen=True, eq=False)
class SignedDistance:
    """Signed distance on the lattice of a volume.

    Parameters
    ----------
    values : ndarray of float32, shape (nz, ny, nx)
        Distances in mm, negative inside the tissue.
    spacing_mm, origin_mm : tuple of float
        As in `storage.values.Volume`.
    interface_mm2 : float
        Area of the interface.
    """

    values: NDArray[np.float32]
    spacing_mm: Triple
    origin_mm: Triple
    interface_mm2: float

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the signed distance of points and its gradient.

        Parameters
        ----------
        points : ndarray, shape (k, 3)
            (x, y, z) in mm. Outside the lattice, the distance to its box is added.

        Returns
        -------
        distance : ndarray, shape (k,)
            Distances in mm; continuous in the points, and smooth except at the faces of the box.
        gradient : ndarray, shape (k, 3)
            Derivative of the distance; approximately the unit normal close to the interface.

        Raises
        ------
        InputError
            If a point is not finite or the array is not of shape (k, 3).
        """
        points = np.asarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(
                f"Signed distances need finite points of shape (k, 3), got shape {points.shape}"
                f" with {int(np.sum(~np.isfinite(points)))} numbers that are not finite."
            )
        distance, gradient = cubic_at_points(self.values, self.spacing_mm, self.origin_mm, points)
        first = np.asarray(self.origin_mm)
        last = first + np.asarray(self.spacing_mm) * (np.array(self.values.shape[::-1]) - 1)
        beyond = points - np.clip(points, first, last)
        outside = np.linalg.norm(beyond, axis=1)
        return distance + outside, gradient + beyond / np.where(outside > 0, outside, 1)[:, None]


def signed_distance(
    labels: Volume,
    inside: tuple[Tissue, ...],
    smooth_voxels: float = SMOOTH_VOXELS,
    band_mm: float = 25.0,
) -> SignedDistance:
    """Return the signed distance of every voxel centre to the interface of a tissue.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    inside : tuple of Tissue
        The enclosed tissues.
    smooth_voxels : float
        Blur of the indicator; see `workers.comparison.observation.isosurface.surface`.
    band_mm : float
        Largest distance, at which values are clipped; > 0.

    Returns
    -------
    SignedDistance
        For its errors see `distances` and `surface` in this package.

    Raises
    ------
    InputError
        If the tissue has no interface in the volume or the band is not positive.
    """
    if not band_mm > 0:
        raise InputError(f"The band of distances must be > 0 mm, found {band_mm}.")
    return distance_to(surface(labels, inside, smooth_voxels), labels, band_mm)


def distance_to(interface: Surface, labels: Volume, band_mm: float) -> SignedDistance:
    """Return the signed distance of every voxel centre to an extracted interface.

    Parameters
    ----------
    interface : Surface
        Interface of a tissue in the labels.
    labels : Volume
        Lattice of the result.
    band_mm : float
        Largest distance, at which values are clipped; > 0.
    """
    step = np.asarray(labels.spacing_mm)
    vertices = interface.vertices - np.asarray(labels.origin_mm)
    values = distances(vertices, interface.triangles, labels.values.shape, step, band_mm)
    box = tuple(
        slice(a, a + n) for a, n in zip(interface.start, interface.field.shape, strict=True)
    )
    values[box] = np.where(interface.field > LEVEL, -values[box], values[box])
    area_mm2 = float(interface.triangle_areas_mm2().sum())
    return SignedDistance(values, labels.spacing_mm, labels.origin_mm, area_mm2)


SMALLEST_VOXELS = 30  # parts smaller than a ball of this many voxels are ignored
# Random points at least r apart reach a density of one per 1.44 r^2 (Renyi's
# parking in the plane, coverage 0.547; J. Feder, J. Theor. Biol. 87 (1980) 237-254).
CLOSEST = 0.835
SEED = 20140213


@dataclass(frozen=True, slots=True)
class Interface:
    """A tissue boundary that is visible in the reference and the deformed scans.

    Parameters
    ----------
    name : str
        Name used in reports.
    inside : tuple of Tissue
        The enclosed tissues.
    """

    name: str
    inside: tuple[Tissue, ...]


OUTLINE = Interface("outline", tuple(tissue for tissue in Tissue if tissue is not Tissue.AIR))
GLANDULAR = Interface("glandular", (Tissue.GLANDULAR,))


@dataclass(frozen=True, eq=False)
class InterfacePoints:
    """Set of k points spread evenly over interfaces.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        (x, y, z) in mm.
    normals : ndarray, shape (k, 3)
        Unit normals pointing out of the tissue.
    interface : ndarray of int32, shape (k,)
        Index of the interface.
    area_mm2 : ndarray, shape (k,)
        Area of the interface that the point represents.
    part : ndarray of int32, shape (k,)
        Index of the connected piece of the interface, such as the shell of one glandular
        compartment; numbered across all interfaces, and within each from the largest.
    """

    points: FloatArray
    normals: FloatArray
    interface: IntArray
    area_mm2: FloatArray
    part: IntArray

    def __len__(self) -> int:
        return len(self.points)

    def of(self, index: NDArray[np.integer]) -> "InterfacePoints":
        """Return the points with these indices."""
        return InterfacePoints(
            self.points[index],
            self.normals[index],
            self.interface[index],
            self.area_mm2[index],
            self.part[index],
        )


def interface_points(
    labels: Volume,
    interfaces: Sequence[Interface],
    spacing_mm: float,
    wall_margin_mm: float,
    clear_mm: float = 0.0,
    smooth_voxels: float = SMOOTH_VOXELS,
) -> InterfacePoints:
    """Spread points over the interfaces of a volume.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels, z from the chest wall to the nipple.
    interfaces : sequence of Interface
    spacing_mm : float
        Spacing of the points, > 0. Each point represents about its square (a fifth more for a
        spacing of only three voxels); points are at least 0.8 times it apart, unless their normals
        are opposite.
    wall_margin_mm : float
        Minimum distance from the lowest point of the body, where the scan ends but not the tissue,
        >= 0.
    clear_mm : float
        Thickness of a single tissue required on either side of a point, along the normal, >= 0; 0
        keeps all points. Strands and clefts about as thin as the errors of a segmentation may be
        missing in another segmentation of the same image, in which the nearest interface is then a
        different one.
    smooth_voxels : float
        See `workers.comparison.observation.isosurface.surface`.

    Returns
    -------
    InterfacePoints
        The points, the same on every call. There are none where a face of the volume's box cuts
        tissue, nor on pieces of only a few voxels.

    Raises
    ------
    InputError
        If a distance is invalid, an interface is not in the volume, or no point is left.
    """
    if not (spacing_mm > 0 and wall_margin_mm >= 0 and clear_mm >= 0):
        raise InputError(
            "Points need a spacing > 0 mm, a margin >= 0 mm from the chest wall and a clearance "
            f">= 0 mm on either side, found {spacing_mm}, {wall_margin_mm} and {clear_mm} mm."
        )
    smallest = (36 * np.pi) ** (1 / 3) * (SMALLEST_VOXELS * labels.voxel_mm3) ** (2 / 3)
    body = surface(labels, OUTLINE.inside, smooth_voxels)
    counted = _parts(body, smallest) >= 0
    # A body of a few voxels has no part of that size; its lowest vertex then does not matter.
    lowest = body.vertices[counted if counted.any() else slice(None), 2].min() + wall_margin_mm
    spread = []
    for interface in interfaces:
        drawn = (
            body
            if interface.inside == OUTLINE.inside
            else surface(labels, interface.inside, smooth_voxels)
        )
        parts = _parts(drawn, smallest)
        parts[drawn.vertices[:, 2] < lowest] = -1
        if clear_mm > 0:
            distance = distance_to(drawn, labels, 2 * clear_mm)
            parts[~_has_clearance(drawn, distance, clear_mm)] = -1
        spread.append(_points_on_surface(drawn, parts, spacing_mm))
    count = [len(points) for points, _, _, _ in spread]
    if not sum(count):
        raise InputError(
            f"No interface point is more than {wall_margin_mm} mm above the chest-wall end of "
            "the body. Lower the margin, or check that z runs from the chest wall to the nipple."
        )
    points, normals, area, part = (np.concatenate(column) for column in zip(*spread, strict=True))
    which = np.repeat(np.arange(len(spread)), count).astype(np.int32)
    _, part = np.unique(np.column_stack([which, part]), axis=0, return_inverse=True)
    return InterfacePoints(points, normals, which, area, part.astype(np.int32))


def _parts(drawn: Surface, smallest_mm2: float) -> IntArray:
    """Return the rank by area of each vertex's connected piece, 0 the largest; -1 if too small."""
    n = len(drawn.vertices)
    ends = drawn.triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
    edges = coo_matrix((np.ones(ends.shape[1], np.int8), ends), shape=(n, n))
    count, piece = connected_components(edges, directed=False)
    area = _sums(piece[drawn.triangles[:, 0]], drawn.triangle_areas_mm2(), count)
    order = np.argsort(-area, kind="stable")
    rank = np.empty(count, np.int32)
    rank[order] = np.arange(count, dtype=np.int32)
    rank[area < smallest_mm2] = -1
    return np.asarray(rank[piece])


def _has_clearance(drawn: Surface, distance: SignedDistance, clear_mm: float) -> BoolArray:
    """Return True where no interface is near in either direction along the normal."""
    way = clear_mm * drawn.normals()
    inwards, _ = distance.at(drawn.vertices - way)
    outwards, _ = distance.at(drawn.vertices + way)
    return np.asarray((inwards < -clear_mm / 2) & (outwards > clear_mm / 2))


def _points_on_surface(
    drawn: Surface, parts: IntArray, spacing_mm: float
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Return points, normals, areas and parts of one interface, without parts < 0."""
    free = parts >= 0
    share = np.repeat(drawn.triangle_areas_mm2() / 3, 3)
    area = _sums(drawn.triangles.ravel(), share, len(drawn.vertices))[free]
    points, normals, parts = drawn.vertices[free], drawn.normals()[free], parts[free]
    if not len(points):
        return points, normals, area, parts
    kept = _thin_out(points, normals, CLOSEST * spacing_mm)
    # A vertex belongs to the nearest point with a similar normal.
    places = np.column_stack([points, spacing_mm * normals])
    _, owner = KDTree(places[kept]).query(places)
    return points[kept], normals[kept], _sums(owner, area, int(kept.sum())), parts[kept]


def _thin_out(points: FloatArray, normals: FloatArray, closest_mm: float) -> BoolArray:
    """Select points such that any two on the same side are at least `closest_mm` apart."""
    near = KDTree(points)
    taken = np.zeros(len(points), np.bool_)
    kept = np.zeros(len(points), np.bool_)
    for p in np.random.default_rng(SEED).permutation(len(points)):
        if not taken[p]:
            kept[p] = True
            around = np.array(near.query_ball_point(points[p], closest_mm), dtype=np.intp)
            taken[around[normals[around] @ normals[p] > 0]] = True
    return kept


def _sums(owner: ArrayLike, parts: FloatArray, count: int) -> FloatArray:
    return np.asarray(np.bincount(owner, parts, count), np.float64)


def checked_interfaces(interface: NDArray[np.integer], known: int) -> None:
    """Check that all interface indices are known.

    Raises
    ------
    InputError
        If an index is unknown; names the highest one.
    """
    highest = int(interface.max(initial=-1))
    if highest >= known:
        raise InputError(
            f"A point is on interface number {highest}, but only {known} were observed. Observe "
            "the interfaces of the points, in the same order."
        )


@dataclass(frozen=True, eq=False)
class Observed:
    """The interfaces observed in one deformed state.

    Parameters
    ----------
    distances : tuple of SignedDistance
        Signed distance to each interface, in the order of the points.
    """

    distances: tuple[SignedDistance, ...]


def observe(
    labels: Volume,
    interfaces: Sequence[Interface],
    smooth_voxels: float = SMOOTH_VOXELS,
    band_mm: float = 25.0,
) -> Observed:
    """Measure the interfaces of a deformed label volume.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels of the deformed state.
    interfaces : sequence of Interface
        Interfaces of the points, in the same order.
    smooth_voxels, band_mm : float
        See `workers.comparison.observation.interface_residual.signed_distance`.

    Raises
    ------
    InputError
        If an interface is not in the volume.
    """
    return Observed(
        tuple(signed_distance(labels, i.inside, smooth_voxels, band_mm) for i in interfaces)
    )


def residual(
    points_mm: FloatArray, points: InterfacePoints, observed: Observed
) -> tuple[FloatArray, FloatArray]:
    """Return the signed distances of moved points to their observed interfaces.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
        Positions of the points moved by the model.
    points : InterfacePoints
        Points of the reference scan.
    observed : Observed

    Returns
    -------
    r : ndarray, shape (k,)
        Signed distances in mm; positive if the moved point is outside the observed tissue.
    normals : ndarray, shape (k, 3)
        Derivative of r: ``dr = normals . dx``. Close to the interface, it is approximately the unit
        normal pointing out of the observed tissue.

    Raises
    ------
    InputError
        If the moved points do not match the reference points, or an interface was not observed.
    """
    if np.shape(points_mm) != points.points.shape:
        raise InputError(
            f"Expected the positions of {len(points)} points, got shape {np.shape(points_mm)}."
        )
    checked_interfaces(points.interface, len(observed.distances))
    r = np.empty(len(points))
    normals = np.empty((len(points), 3))
    for number, distance in enumerate(observed.distances):
        own = points.interface == number
        r[own], normals[own] = distance.at(points_mm[own])
    return r, normals

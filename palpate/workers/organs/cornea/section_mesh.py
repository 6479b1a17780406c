"""A structured mesh of 6-node triangles between the two surfaces of a section.

With the quality of its triangles, and the surfaces of the section displaced with the mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.triangles import shape_functions
from palpate.workers.organs.cornea.section_measures import check_section
from palpate.workers.organs.cornea.section_outline import Section, arclength_mm, points_at


@dataclass(frozen=True, eq=False)
class T6Mesh:
    """Quadratic triangles of a section.

    Parameters
    ----------
    nodes_mm : ndarray, shape (n, 2)
    triangles : ndarray of int32, shape (m, 6)
        Corners 0, 1, 2 counter-clockwise, then the midsides 01, 12 and 20.
    anterior, posterior : ndarray of int32, shape (2 a + 1,) and (2 b + 1,)
        Nodes on the outer and the inner surface from left to right, corners and midsides
        alternating, starting and ending with a corner.
    left, right : ndarray of int32
        Nodes on the two edges of the section (the limbus), from posterior to anterior.
    """

    nodes_mm: FloatArray
    triangles: IntArray
    anterior: IntArray
    posterior: IntArray
    left: IntArray
    right: IntArray


@dataclass(frozen=True)
class T6Quality:
    r"""Quality of a mesh of 6-node triangles.

    Parameters
    ----------
    smallest_shape, mean_shape : float
        Mean ratio of the corner triangles, :math:`4 \sqrt 3 A / (a^2 + b^2 + c^2)`: 1 for
        equal sides, 0 for a triangle without area.
    smallest_jacobian : float
        Lower bound of the Jacobian determinant in any element, over twice the area of its
        corner triangle: 1 for straight sides, > 0 if the map is one-to-one.
    """

    smallest_shape: float
    mean_shape: float
    smallest_jacobian: float


def t6_quality(mesh: T6Mesh) -> T6Quality:
    """Return the quality of a mesh.

    The Jacobian determinant of a 6-node triangle is a polynomial of degree two. The smallest
    of its six Bernstein coefficients bounds it from below, so a positive value proves that no
    element is folded (A. Johnen, J.-F. Remacle, C. Geuzaine, J. Comput. Phys. 233, 2013).
    """
    corners = mesh.nodes_mm[mesh.triangles[:, :3]]
    sides = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    shape = 4 * np.sqrt(3) * area / np.sum(sides**2, axis=(1, 2))
    relative = _jacobian_coefficients(mesh).min(axis=1) / (2 * np.abs(area))
    return T6Quality(
        smallest_shape=float(shape.min()),
        mean_shape=float(shape.mean()),
        smallest_jacobian=float(relative.min()),
    )


def _jacobian_coefficients(mesh: T6Mesh) -> FloatArray:
    """Return the Bernstein coefficients of the Jacobian determinants, shape (m, 6)."""
    at_nodes = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])
    _, slopes = shape_functions(at_nodes)
    nodes = mesh.nodes_mm[mesh.triangles]
    a, b = (np.einsum("qn,eni->eqi", slopes[:, :, k], nodes) for k in range(2))
    values = a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0]
    corner, middle = values[:, :3], values[:, 3:]
    edges = 2 * middle - 0.5 * (corner + np.roll(corner, -1, axis=1))
    return np.concatenate([corner, edges], axis=1)


# Stations closer than this fraction of the surface's length are merged.
SAME_STATION = 1e-6


def mesh_section(
    section: Section, elements: int = 960, nodes_at_x_mm: Sequence[float] = ()
) -> T6Mesh:
    """Mesh a section with quadratic triangles between its surfaces.

    Cross lines join points at equal fractions of the length of both surfaces. Each cell between
    two cross lines and two layers is split into two triangles, with alternating diagonals, so a
    symmetric section has a symmetric mesh. Midside nodes on the surfaces are on the surfaces,
    not on their chords. Nodes are numbered across the cornea first, from the left edge to the
    right one: neighbours differ by at most 4 layers + 2.

    Parameters
    ----------
    section : Section
        The undeformed section: x ascends along both surfaces.
    elements : int
        Approximate number of triangles; layers come in whole numbers, and cross lines between
        the given x in even ones.
    nodes_at_x_mm : sequence of float
        Positions on the anterior surface that get a corner node, such as the edges of the jet,
        where the load is discontinuous.

    Returns
    -------
    T6Mesh

    Raises
    ------
    InputError
        If `check_section` rejects the section, a given x is outside the anterior surface or
        repeated, there are fewer than 8 elements, or the surfaces differ so much that an
        element would be folded.
    """
    check_section(section)
    if elements < 8:
        raise InputError(f"A section needs at least 8 triangles, got {elements}.")
    fixed = _fixed_stations(section, nodes_at_x_mm)
    layers, counts = _counts(section, elements, fixed)
    stations = np.concatenate(
        [[0.0]]
        + [
            np.linspace(a, b, 2 * n + 1)[1:]
            for a, b, n in zip(fixed[:-1], fixed[1:], counts, strict=True)
        ]
    )
    mesh = _structured(section, stations, layers)
    quality = t6_quality(mesh)
    if quality.smallest_jacobian <= 0 or quality.smallest_shape <= 0:
        raise InputError(
            "The two surfaces of the section leave folded elements between them (smallest "
            f"relative Jacobian {quality.smallest_jacobian:.3f}). Smooth the contours, or let "
            "both begin and end on the same edges."
        )
    return mesh


def _fixed_stations(section: Section, nodes_at_x_mm: Sequence[float]) -> FloatArray:
    """Return the fractions of the anterior length that need a corner node, with 0 and 1."""
    surface = section.anterior_mm
    first, last = float(surface[0, 0]), float(surface[-1, 0])
    for x in nodes_at_x_mm:
        if not first < x < last:
            raise InputError(
                f"A node was requested at x = {x} mm, but the anterior surface extends from "
                f"{first:.3f} to {last:.3f} mm. Is the jet wider than the cornea, or off it?"
            )
    along = arclength_mm(surface)
    wished = np.sort(np.interp(np.asarray(nodes_at_x_mm, dtype=float), surface[:, 0], along))
    fixed = np.concatenate([[0.0], wished / along[-1], [1.0]])
    if np.any(np.diff(fixed) < SAME_STATION):
        raise InputError(
            f"Two nodes were requested at one position: x = {sorted(nodes_at_x_mm)} mm. "
            "Give each position once, and none at the edge of the section."
        )
    return fixed


def _counts(section: Section, elements: int, fixed: FloatArray) -> tuple[int, list[int]]:
    """Return the number of layers, and of cells along the cornea between fixed stations."""
    length = float(arclength_mm(section.anterior_mm)[-1])
    outline = section.outline_mm
    following = np.roll(outline, -1, axis=0)
    area = 0.5 * abs(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]))
    cells = elements / 2
    layers = max(1, int(np.sqrt(cells * area / length**2)))
    parts = np.diff(fixed)
    # Even numbers keep the alternating diagonals symmetric; among the roundings, the one with the
    # total closest to the requested number, and then with the most even spacing, is used.
    best: tuple[float, float, list[int]] | None = None
    for scale in np.linspace(0.9, 1.1, 81):
        counts = [2 * max(1, round(scale * part * cells / layers / 2)) for part in parts]
        spacing = parts / counts
        rank = (abs(sum(counts) * layers - cells), float(spacing.max() / spacing.min()))
        if best is None or rank < best[:2]:
            best = (*rank, counts)
    assert best is not None
    return layers, best[2]


def _structured(section: Section, stations: FloatArray, layers: int) -> T6Mesh:
    """Return the mesh on given stations (corners and midsides alternating)."""
    outer = points_at(section.anterior_mm, stations * arclength_mm(section.anterior_mm)[-1])
    inner = points_at(section.posterior_mm, stations * arclength_mm(section.posterior_mm)[-1])
    height = np.linspace(0.0, 1.0, 2 * layers + 1)[None, :, None]
    nodes = inner[:, None] + height * (outer - inner)[:, None]
    number = np.arange(nodes.shape[0] * nodes.shape[1], dtype=np.int32).reshape(nodes.shape[:2])
    return T6Mesh(
        nodes_mm=np.ascontiguousarray(nodes.reshape(-1, 2)),
        triangles=_triangles(number),
        anterior=number[:, -1].copy(),
        posterior=number[:, 0].copy(),
        left=number[0].copy(),
        right=number[-1].copy(),
    )


def _triangles(number: IntArray) -> IntArray:
    """Return two triangles for each 3 x 3 block of nodes; the first axis runs along the cornea."""
    triangles = []
    for i in range(0, number.shape[0] - 2, 2):
        for j in range(0, number.shape[1] - 2, 2):
            n = number[i : i + 3, j : j + 3]
            if (i // 2 + j // 2) % 2 == 0:
                triangles.append([n[0, 0], n[2, 0], n[2, 2], n[1, 0], n[2, 1], n[1, 1]])
                triangles.append([n[0, 0], n[2, 2], n[0, 2], n[1, 1], n[1, 2], n[0, 1]])
            else:
                triangles.append([n[0, 0], n[2, 0], n[0, 2], n[1, 0], n[1, 1], n[0, 1]])
                triangles.append([n[2, 0], n[2, 2], n[0, 2], n[2, 1], n[1, 2], n[1, 1]])
    return np.asarray(triangles, dtype=np.int32)


def deformed_section(
    section: Section, mesh: T6Mesh, displacement_mm: FloatArray, points_per_side: int = 4
) -> Section:
    """Return the surfaces of a section, displaced with its mesh.

    Points of the undeformed surfaces are displaced by the quadratic interpolation along the
    sides of the elements, so a zero displacement returns the original surfaces, independent of
    the mesh.

    Parameters
    ----------
    section : Section
        The undeformed section that was meshed.
    mesh : T6Mesh
    displacement_mm : ndarray, shape (n, 2)
    points_per_side : int
        Number of pieces per side of an element; at least 1.

    Returns
    -------
    Section
        As many pieces as the surface has sides, times `points_per_side`.

    Raises
    ------
    InputError
        If the displacement does not match the mesh.
    """
    if displacement_mm.shape != mesh.nodes_mm.shape:
        raise InputError(
            f"A displacement of shape {displacement_mm.shape} does not match a mesh of "
            f"{len(mesh.nodes_mm)} nodes; expected {mesh.nodes_mm.shape}."
        )
    if points_per_side < 1:
        raise InputError(f"A side needs at least one piece, got {points_per_side}.")
    return Section(
        anterior_mm=_moved_surface(
            section.anterior_mm, mesh, mesh.anterior, displacement_mm, points_per_side
        ),
        posterior_mm=_moved_surface(
            section.posterior_mm, mesh, mesh.posterior, displacement_mm, points_per_side
        ),
    )


def _moved_surface(
    surface: FloatArray, mesh: T6Mesh, nodes: IntArray, displacement: FloatArray, pieces: int
) -> FloatArray:
    # Nodes are on the surface, so their x determines the position along it.
    along = np.interp(mesh.nodes_mm[nodes, 0], surface[:, 0], arclength_mm(surface))
    t = np.arange(pieces) / pieces
    shape = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
    sides = np.stack([nodes[:-2:2], nodes[1::2], nodes[2::2]])
    moved = np.einsum("kp,ksi->spi", shape, displacement[sides]).reshape(-1, 2)
    places = np.einsum("kp,ks->sp", shape, np.stack([along[:-2:2], along[1::2], along[2::2]]))
    last = displacement[nodes[-1:]]
    return points_at(surface, np.append(places.ravel(), along[-1])) + np.concatenate([moved, last])

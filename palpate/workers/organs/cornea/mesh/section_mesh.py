"""A structured mesh of 6-node triangles between the two surfaces of a section."""

from collections.abc import Sequence

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.mesh.quality import t6_quality
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.section.checks import check_section
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.polyline import arclength_mm, points_at

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

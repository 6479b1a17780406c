"""Quality measures of tetrahedra.

Every measure is 1 for the regular tetrahedron. M1..M4 and M5 are in [0, 1]; the
aspect ratio grows without bound as a tetrahedron degrades.

========  ====================================================================
M1        3 r / R, inscribed over circumscribed radius
M2        2 sqrt(6) r / longest edge
M3        12 (3 V)^(2/3) / sum of squared edges (mean ratio)
M4        smallest solid angle / 0.55129 sr (its value in the regular tetrahedron)
M5        smallest / largest volume; one number for a mesh
aspect    longest edge / shortest altitude / 1.2247
========  ====================================================================

References: Parthasarathy, Graichen and Hathaway, "A comparison of tetrahedron
quality measures", Finite Elem. Anal. Des. 15 (1994); Liu and Joe, "Relationship
between tetrahedron shape measures", BIT 34 (1994).
"""

from typing import TypedDict

import numpy as np

from palpate.storage.values import FloatArray, TetMesh

PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # face i is opposite to node i
REGULAR_SOLID_ANGLE = float(3 * np.arccos(1 / 3) - np.pi)  # 0.55129 sr
REGULAR_ASPECT = float(np.sqrt(1.5))


def volumes_mm3(mesh: TetMesh) -> FloatArray:
    """Return signed volumes, shape (m,)."""
    x = mesh.nodes[mesh.tets]
    d = x[:, 1:] - x[:, :1]
    return np.einsum("mi,mi->m", d[:, 0], np.cross(d[:, 1], d[:, 2])) / 6


def measures(mesh: TetMesh) -> dict[str, FloatArray]:
    """Return M1 to M4, aspect ratio and volume of each tetrahedron, arrays of shape (m,)."""
    x = mesh.nodes[mesh.tets]
    volume = volumes_mm3(mesh)
    edge2 = np.stack([((x[:, a] - x[:, b]) ** 2).sum(axis=1) for a, b in PAIRS])
    area = np.stack(
        [
            0.5 * np.linalg.norm(np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]), axis=1)
            for a, b, c in FACES
        ]
    )
    longest = np.sqrt(edge2.max(axis=0))
    inscribed = 3 * volume / area.sum(axis=0)
    # Opposite edges are 0-5, 1-4, 2-3. R from their products (Crelle): 24 V R = 4 T, with T
    # the area of the triangle whose sides are the products.
    p = np.sort(np.sqrt(edge2[[0, 1, 2]] * edge2[[5, 4, 3]]), axis=0)[::-1]
    crelle = (
        (p[0] + (p[1] + p[2]))
        * np.maximum(p[2] - (p[0] - p[1]), 0)
        * (p[2] + (p[0] - p[1]))
        * (p[0] + (p[1] - p[2]))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        circumscribed = np.sqrt(crelle) / (24 * volume)
        return {
            "M1": 3 * inscribed / circumscribed,
            "M2": 2 * np.sqrt(6) * inscribed / longest,
            "M3": np.sign(volume) * 12 * (3 * np.abs(volume)) ** (2 / 3) / edge2.sum(axis=0),
            "M4": _smallest_solid_angle(x, volume) / REGULAR_SOLID_ANGLE,
            "aspect": longest * area.max(axis=0) / (3 * volume) / REGULAR_ASPECT,
            "volume_mm3": volume,
        }


def _smallest_solid_angle(x: FloatArray, volume: FloatArray) -> FloatArray:
    """Return the smallest of the four solid angles of each tetrahedron, in sr.

    Uses tan(angle / 2) of Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    smallest = np.full(len(x), np.inf)
    for corner in range(4):
        a, b, c = (x[:, (corner + k) % 4] - x[:, corner] for k in (1, 2, 3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        below = (
            la * lb * lc
            + np.einsum("mi,mi->m", a, b) * lc
            + np.einsum("mi,mi->m", a, c) * lb
            + np.einsum("mi,mi->m", b, c) * la
        )
        smallest = np.minimum(smallest, 2 * np.arctan2(6 * volume, below))
    return smallest


class Distribution(TypedDict):
    """Extremes, mean and percentiles of a measure over all tetrahedra."""

    min: float
    mean: float
    max: float
    p01: float
    p50: float
    p99: float


class MeshSummary(TypedDict):
    """Size and quality of a mesh, see `summarise`."""

    nodes: int
    tets: int
    volume_mm3: float
    M5: float
    bad: int
    M1: Distribution
    M2: Distribution
    M3: Distribution
    M4: Distribution
    aspect: Distribution


def summarise(mesh: TetMesh) -> MeshSummary:
    """Summarise size and quality of a mesh in plain numbers, ready for JSON.

    Returns
    -------
    MeshSummary
        ``nodes``, ``tets``, ``volume_mm3``, ``M5``, ``bad`` (tetrahedra of aspect ratio 10 or
        more) and for each of M1..M4 and the aspect ratio a dict of ``min``, ``mean``, ``max``
        and the percentiles ``p01``, ``p50``, ``p99``.
    """
    measured = measures(mesh)
    volume, aspect = measured["volume_mm3"], measured["aspect"]
    return MeshSummary(
        nodes=len(mesh.nodes),
        tets=len(mesh.tets),
        volume_mm3=float(volume.sum()),
        M5=float(volume.min() / volume.max()),
        bad=int(np.count_nonzero(aspect >= 10)),
        M1=_distribution(measured["M1"]),
        M2=_distribution(measured["M2"]),
        M3=_distribution(measured["M3"]),
        M4=_distribution(measured["M4"]),
        aspect=_distribution(aspect),
    )


def _distribution(values: FloatArray) -> Distribution:
    p01, p50, p99 = (float(v) for v in np.percentile(values, [1, 50, 99]))
    return Distribution(
        min=float(values.min()),
        mean=float(values.mean()),
        max=float(values.max()),
        p01=p01,
        p50=p50,
        p99=p99,
    )

"""Boxes of tetrahedra for tests: every grid cell is cut into six along its diagonal."""

from itertools import permutations

import numpy as np

from palpate.storage.values import TetMesh

EVEN = {(0, 1, 2), (1, 2, 0), (2, 0, 1)}


def box_mesh(cells, low_mm, high_mm, *, jitter=0.0, seed=0) -> TetMesh:
    """Return Kuhn's (Freudenthal's) cut of a box, with inner nodes moved by up to `jitter` cells.

    Nodes on a side of the box stay on it, so that the box keeps its shape.
    """
    cells, low_mm, high_mm = (np.asarray(a) for a in (cells, low_mm, high_mm))
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low_mm, high_mm, cells, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ids = np.arange(len(nodes)).reshape(cells + 1)
    corner = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for order in permutations(range(3)):
        path = [corner]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        tet = np.stack([ids[tuple(p.T)] for p in path], axis=1)
        tets.append(tet if order in EVEN else tet[:, [0, 2, 1, 3]])
    moves = np.random.default_rng(seed).uniform(-jitter, jitter, nodes.shape)
    moves *= (high_mm - low_mm) / cells
    moves[(nodes == low_mm) | (nodes == high_mm)] = 0.0
    return TetMesh(nodes + moves, np.concatenate(tets).astype(np.int32))


def inside_some_tet(mesh: TetMesh, displacement_mm, points_mm, tolerance: float):
    """Return a mask of the points whose best element has barycentric coordinates >= -tolerance."""
    deformed = mesh.nodes + displacement_mm
    best = np.full(len(points_mm), -np.inf)
    for tet in mesh.tets:
        corners = deformed[tet]
        rest = np.linalg.solve((corners[1:] - corners[0]).T, (points_mm - corners[0]).T)
        best = np.maximum(best, np.minimum(rest.min(axis=0), 1.0 - rest.sum(axis=0)))
    return best >= -tolerance

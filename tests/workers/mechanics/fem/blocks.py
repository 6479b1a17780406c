"""Small bodies with known solutions."""

import itertools
from dataclasses import replace

import numpy as np
from scipy import sparse

from palpate.storage.values import TetMesh, Tissue
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, MeshLevel
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import LevelModel, Model, Stage, prepare
from palpate.workers.mechanics.fem.loads_and_regions import Device, NoPlates, Wall
from palpate.workers.mechanics.fem.mesh_level import Level

OPEN = Stage(None, None, 1.0, Device())


def cube(cells: int, side: float = 10.0, jitter: float = 0.0, seed: int = 0) -> TetMesh:
    """A cube of Kuhn tetrahedra, its inner nodes moved at random."""
    axis = np.linspace(0, side, cells + 1)
    nodes = np.array(list(itertools.product(axis, repeat=3)))
    inner = ((nodes > 1e-9) & (nodes < side - 1e-9)).all(axis=1)
    rng = np.random.default_rng(seed)
    nodes[inner] += jitter * side / cells * rng.uniform(-1, 1, (inner.sum(), 3))
    stride = np.array([(cells + 1) ** 2, cells + 1, 1])
    tets = []
    for corner in itertools.product(range(cells), repeat=3):
        for path in itertools.permutations(range(3)):
            at = np.array(corner)
            tet = [at @ stride]
            for step in path:
                at = at + np.eye(3, dtype=int)[step]
                tet.append(at @ stride)
            tets.append(tet)
    tets = np.array(tets, np.int32)
    edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    flipped = np.linalg.det(edges) < 0
    tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
    return TetMesh(nodes, tets)


def free_surface(mesh: TetMesh) -> np.ndarray:
    """Outward boundary triangles without those of the wall z = 0."""
    t = mesh.tets
    faces = np.concatenate([t[:, [0, 2, 1]], t[:, [0, 1, 3]], t[:, [1, 2, 3]], t[:, [0, 3, 2]]])
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    boundary = faces[first[count == 1]]
    return boundary[~(mesh.nodes[boundary][:, :, 2] < 1e-9).all(axis=1)].astype(np.int32)


def level_of(
    mesh: TetMesh, tissue: np.ndarray | None = None, prolongation: sparse.csr_matrix | None = None
) -> MeshLevel:
    """A mesh level, all fat unless `tissue` is given."""
    fractions = np.zeros((len(mesh.tets), len(Tissue)), np.float32)
    fractions[np.arange(len(mesh.tets)), Tissue.FAT if tissue is None else tissue] = 1
    wall = np.flatnonzero(mesh.nodes[:, 2] < 1e-9).astype(np.int32)
    return MeshLevel(mesh, fractions, wall, free_surface(mesh), prolongation)


def model_of(*meshes: TetMesh) -> Model:
    """A hierarchy of meshes of the same body, coarse to fine."""
    levels = [level_of(meshes[0])]
    for coarse, fine in itertools.pairwise(meshes):
        levels.append(level_of(fine, prolongation=interpolation(coarse, fine.nodes)))
    return prepare(Hierarchy(tuple(levels)))


def interpolation(coarse: TetMesh, points: np.ndarray) -> sparse.csr_matrix:
    """Barycentric interpolation by trying every tetrahedron."""
    corner = coarse.nodes[coarse.tets]
    inverse = np.linalg.inv(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))
    local = np.einsum("eij,pej->pei", inverse, points[:, None] - corner[None, :, 0])
    weights = np.concatenate([1 - local.sum(axis=2, keepdims=True), local], axis=2)
    best = weights.min(axis=2).argmax(axis=1)
    rows = np.arange(len(points))
    w = weights[rows, best]
    return sparse.csr_matrix(
        (w.ravel(), (np.repeat(rows, 4), coarse.tets[best].ravel())),
        shape=(len(points), len(coarse.nodes)),
    )


def loose_level(model: LevelModel, constants: Constants, **options: object) -> Level:
    """A level without plates or springs; tests prescribe the displacements they need."""
    loose = Wall(held=(False, False, False))
    level = Level.build(model, Problem({Tissue.FAT: constants}, NoPlates(), wall=loose, **options))
    return replace(level, springs=np.zeros_like(level.springs))


def holding(level: Level, held: np.ndarray) -> Level:
    """Return the level with more displacements prescribed: `held` is (n, 3), or (n,) for all."""
    held = held if held.ndim == 2 else held[:, None]
    return replace(level, free=np.where(held, np.float32(0), level.free))

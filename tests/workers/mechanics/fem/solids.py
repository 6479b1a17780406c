"""Bodies made of a mapped lattice of cells, on nested meshes."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

from palpate.storage.values import BoolArray, FloatArray, TetMesh, Tissue
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, MeshLevel
from palpate.workers.mechanics.fem.boundary_value_problem import Constants
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box, Hold

# The planes x = 0 and y = 0 are planes of symmetry; the wall is the third.
FAR = np.inf
MIRRORS = (
    Hold(Box((-1e-6, -FAR, -FAR), (1e-6, FAR, FAR)), axes=(True, False, False)),
    Hold(Box((-FAR, -1e-6, -FAR), (FAR, 1e-6, FAR)), axes=(False, True, False)),
)

Cells = tuple[int, int, int]
Shape = Callable[[FloatArray], FloatArray]
Where = Callable[[FloatArray], BoolArray]

KUHN = [
    np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(path)]], axis=0)
    for path in itertools.permutations(range(3))
]


def box(*size: float, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    """Return a block of this size in mm."""
    return lambda unit: np.asarray(origin) + unit * np.asarray(size)


def turned(shape: Shape, R: FloatArray) -> Shape:
    """Return `shape`, rotated about the origin."""
    return lambda unit: shape(unit) @ R.T


def ball(radius: float, hole: float = 0.0, hollow: float = 0.0) -> Shape:
    """Return an eighth of a ball: the lattice's shells max(a, b, c) = const become spheres.

    Cells with max(a, b, c) <= `hollow` are left for a hole of radius `hole`.
    """

    def shape(unit: FloatArray) -> FloatArray:
        shell = unit.max(axis=1, initial=0)
        length = np.maximum(np.linalg.norm(unit, axis=1), 1e-300)
        r = hole + (shell - hollow) / (1 - hollow) * (radius - hole)
        return unit * (r / length)[:, None]

    return shape


def body(
    cells: Sequence[Cells],
    shape: Shape,
    *,
    jitter: float = 0.0,
    wall: bool = True,
    bare: Where | None = None,
    hollow: float = 0.0,
) -> Model:
    """Return a body of fat on nested lattices, coarse to fine.

    Parameters
    ----------
    cells : sequence of (nx, ny, nz)
        Cells of each level.
    shape : callable
        Maps the unit cube, (k, 3), to mm.
    jitter : float
        Largest random shift of inner nodes, in cells.
    wall : bool
        Whether the face c = 0 of the lattice is the chest wall.
    bare : callable, optional
        Selects points of the unit cube without a free surface: planes of symmetry.
    hollow : float
        Cells with max(a, b, c) <= `hollow` are left out.
    """
    levels = []
    for number, count in enumerate(cells):
        unit = _lattice(count)
        tets = _tetrahedra(count)
        if hollow:
            tets = tets[unit[tets].mean(axis=1).max(axis=1) > hollow]
            used, renumbered = np.unique(tets, return_inverse=True)
            unit, tets = unit[used], renumbered.reshape(-1, 4)
        inner = ((unit > 0) & (unit < 1)).all(axis=1)
        rng = np.random.default_rng(number)
        place = unit + inner[:, None] * rng.uniform(-jitter, jitter, unit.shape) / count
        nodes = shape(place)
        edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
        flipped = np.linalg.det(edges) < 0
        tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
        mesh = TetMesh(nodes, tets.astype(np.int32))
        fractions = np.zeros((len(tets), len(Tissue)), np.float32)
        fractions[:, Tissue.FAT] = 1
        on_wall = unit[:, 2] == 0 if wall else np.zeros(len(unit), bool)
        surface = boundary_triangles(mesh.tets)
        surface = surface[~on_wall[surface].all(axis=1)]
        if bare is not None:
            surface = surface[~bare(unit[surface].mean(axis=1))]
        held = np.flatnonzero(on_wall).astype(np.int32)
        transfer = None if number == 0 else _interpolation(cells[number - 1], unit)
        levels.append(MeshLevel(mesh, fractions, held, surface, transfer))
    return prepare(Hierarchy(tuple(levels)))


def symmetric(unit: FloatArray) -> BoolArray:
    """Select the faces a = 0 and b = 0."""
    return np.asarray((unit[:, :2] < 1e-12).any(axis=1))


def rotation(axis: tuple[float, float, float], degrees: float) -> FloatArray:
    """Return the rotation matrix about an axis through the origin."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def nominal_mpa(c: Constants, *stretch: float) -> FloatArray:
    """Return the principal nominal stresses of the neo-Hookean matrix.

    P_i = mu J^-2/3 (l_i - I1 / (3 l_i)) + kappa (J - 1) J / l_i.
    """
    l = np.asarray(stretch)
    J, I1 = l.prod(), (l**2).sum()
    return c.mu_mpa * J ** (-2 / 3) * (l - I1 / 3 / l) + c.kappa_mpa * (J - 1) * J / l


def _lattice(cells: Cells) -> FloatArray:
    axes = [np.linspace(0, 1, n + 1) for n in cells]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _tetrahedra(cells: Cells) -> np.ndarray:
    corner = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    stride = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    return np.concatenate([(corner[:, None] + path) @ stride for path in KUHN])


def _interpolation(cells: Cells, unit: FloatArray) -> sparse.csr_matrix:
    """Return linear interpolation in the Kuhn tetrahedra of the lattice with `cells`."""
    scaled = unit * cells
    corner = np.minimum(scaled.astype(int), np.asarray(cells) - 1)
    local = scaled - corner
    order = np.argsort(-local, axis=1, kind="stable")
    falling = np.take_along_axis(local, order, axis=1)
    weights = -np.diff(falling, axis=1, prepend=1.0, append=0.0)
    stride = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    steps = np.concatenate([np.zeros((len(unit), 1), int), np.cumsum(stride[order], axis=1)], 1)
    rows = np.repeat(np.arange(len(unit)), 4)
    columns = ((corner @ stride)[:, None] + steps).ravel()
    n = int(np.prod(np.asarray(cells) + 1))
    return sparse.csr_matrix((weights.ravel(), (rows, columns)), shape=(len(unit), n))

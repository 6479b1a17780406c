"""Boxes of quadratic tetrahedra, compressed by plates normal to y."""

from itertools import permutations

import numpy as np

from palpate.workers.blind.solver.plate_contact import Plate
from palpate.workers.blind.solver.plate_equilibrium import System, Topology, Wall, topology_of
from palpate.workers.blind.solver.quadratic_mesh import FACE_WEIGHTS, QuadraticMesh, quadratic
from palpate.workers.blind.solver.tissue_energy import ElementMaterials

Y_FRAME = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def block(counts, sides):
    """Return a box that starts at x, y = -side / 2 and z = 0, six tetrahedra per cell (Kuhn)."""
    nx, ny, nz = counts
    axes = [np.linspace(-0.5, 0.5, n + 1) for n in (nx, ny)] + [np.linspace(0, 1, nz + 1)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    nodes = np.column_stack([x.ravel(), y.ravel(), z.ravel()]) * sides
    number = np.arange(len(nodes)).reshape(nx + 1, ny + 1, nz + 1)
    tets = []
    for order in permutations(range(3)):
        steps = np.zeros((4, 3), int)
        for k, axis in enumerate(order):
            steps[k + 1] = steps[k]
            steps[k + 1, axis] += 1
        corners = [number[i : i + nx, j : j + ny, k : k + nz].ravel() for i, j, k in steps]
        tets.append(np.column_stack(corners))
    tets = np.concatenate(tets)
    edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    turned = np.linalg.det(edges) < 0
    tets[turned, :2] = tets[turned, 1::-1]
    return quadratic(nodes, tets.astype(np.int32), 0.0)


def materials(mesh: QuadraticMesh, mu=0.01, kappa=0.5, eta=0.0, fung=0.0, growth=1.0):
    """Return uniform materials with fibres along z."""
    shape = (len(mesh.cells), 4)
    fibre = np.tile([0.0, 0.0, 1.0], (*shape, 1))
    return ElementMaterials(*(np.full(shape, v) for v in (mu, kappa, eta, fung, growth)), fibre)


def plates(half, slopes=(0.0, 0.0), sag=0.0, edge=-np.inf):
    """Return plates at y = -half and half that start at z = edge; the upper one slopes and sags."""
    pivot = np.zeros(3)
    lower = Plate(Y_FRAME, pivot, -half, -1.0, np.zeros(2), 0.0, 50.0, edge)
    return lower, Plate(Y_FRAME, pivot, half, 1.0, np.array(slopes), sag, 50.0, edge)


def wall(topology: Topology, spring):
    """Return a wall with springs in MPa/mm along x and y, fixed along z."""
    places = (len(topology.mesh.wall), len(FACE_WEIGHTS), 1)
    return Wall(np.tile([spring, spring, 0.0], places))


def pressed(mesh, of, half, spring=1e-7, friction=0.0, gravity=(0.0, 0.0, 0.0), sheet=None):
    """Return a block between flat plates."""
    topology = topology_of(mesh)
    rubbing = np.full(topology.skin.areas.shape, friction)
    return System(
        topology, of, wall(topology, spring), plates(half), rubbing, np.asarray(gravity), sheet
    )

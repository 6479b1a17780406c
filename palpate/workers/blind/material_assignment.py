"""Material constants of the elements of a scene.

Tissue varies within an element: each of its four points gets the mean modulus of the quarter of the
element around it, sampled from the voxels.
"""

import numpy as np

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.blind.scene import Scene
from palpate.workers.blind.solver.element_energy import ElementMaterials
from palpate.workers.blind.solver.quadratic_element import QuadraticMesh, points_in_cells

SAMPLES = 64  # per element


def _spread(count: int) -> FloatArray:
    """Return barycentric coordinates (count, 4) of points spread evenly in a tetrahedron.

    Sorted gaps between three uniform numbers are uniform in the simplex (L. Devroye,
    Non-uniform Random Variate Generation, 1986, chapter V.2); the seed is part of the
    method.
    """
    cuts = np.sort(np.random.default_rng(1).random((count, 3)), axis=1)
    return np.diff(np.hstack([np.zeros((count, 1)), cuts, np.ones((count, 1))]), axis=1)


def is_glandular(labels: Volume, points: FloatArray) -> FloatArray:
    """Return 1.0 at points (k, 3) in glandular voxels, else 0."""
    index = np.rint((points - np.asarray(labels.origin_mm)) / labels.spacing_mm).astype(np.intp)
    x, y, z = np.clip(index, 0, np.array(labels.shape_xyz) - 1).T
    return (labels.values[z, y, x] == Tissue.GLANDULAR).astype(np.float64)


def materials_of(scene: Scene, mesh: QuadraticMesh, labels: Volume) -> ElementMaterials:
    """Return the constants at the four points of every element.

    Parameters
    ----------
    scene : Scene
    mesh : QuadraticMesh
        Mesh of m elements.
    labels : Volume
        `Tissue` labels of the undeformed body.
    """
    at = points_in_cells(mesh)
    weights = _spread(SAMPLES)
    owner = weights.argmax(axis=1)
    corners = mesh.nodes[mesh.cells[:, :4]]
    shape = at.shape[:2]
    young, eta, stretch = np.zeros(shape), np.zeros(shape), np.ones(shape)
    fat, gland = scene.constants.E_fat_kpa / 1e3, scene.constants.E_gl_kpa / 1e3
    for q in range(4):
        mine = weights[owner == q]
        points = np.einsum("sa,mai->msi", mine, corners).reshape(-1, 3)
        glandular = is_glandular(labels, points)
        factor = np.exp(sum((f(points) for f in scene.ln_stiffness), np.zeros(len(points))))
        grown = sum((g(points, glandular) for g in scene.growth), np.zeros(len(points)))
        young[:, q] = _means((fat + (gland - fat) * glandular) * factor, len(mine))
        fibres = scene.constants.eta_kpa / 1e3 * factor
        if scene.ln_gland_fibres is not None:
            fibres = fibres * np.exp(glandular * scene.ln_gland_fibres(points))
        eta[:, q] = _means(fibres, len(mine))
        stretch[:, q] += _means(grown, len(mine))
    flat = at.reshape(-1, 3)
    fibre = np.tile([0.0, 0.0, 1.0], (len(flat), 1)) if scene.fibres is None else scene.fibres(flat)
    return ElementMaterials(
        mu=young / (2 * (1 + scene.nu)),
        kappa=young / (3 * (1 - 2 * scene.nu)),
        eta=eta,
        fung=np.full(shape, scene.fung),
        growth=stretch,
        fibre=np.ascontiguousarray(fibre.reshape(at.shape)),
    )


def _means(values: FloatArray, count: int) -> FloatArray:
    return np.asarray(values.reshape(-1, count).mean(axis=1))

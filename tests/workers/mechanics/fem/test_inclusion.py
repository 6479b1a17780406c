"""A stiff ball in a soft body under a remote strain."""

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Inclusion, Problem
from palpate.workers.mechanics.fem.discretisation import State
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.element_laws import element_constants
from palpate.workers.mechanics.fem.energy_minimisation import minimise
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.multigrid import solver_factory
from tests.workers.mechanics.fem.blocks import OPEN, holding
from tests.workers.mechanics.fem.solids import ball, body, symmetric

RADIUS, FAR_MM = 120.0, 480.0
# Shells of the mesh: the edge of the inclusion, smoothed over 1 mm, is within one.
SHELLS_MM = (0.0, 60.0, 117.0, 119.0, 121.0, 130.0, 148.0, 176.0, 224.0, 310.0, FAR_MM)
E, NU = 0.01, 0.3


def concentration(contrast: float) -> tuple[float, float]:
    """Return the ratio of inner to remote strain, of volume and of shape.

    Eshelby, Proc. R. Soc. Lond. A 241 (1957) 376-396, Eqs. 3.12-3.14 for a sphere with
    the matrix's nu: T = 1 / (1 + s (contrast - 1)), s = (1 + nu) / 3(1 - nu) for volume
    and 2 (4 - 5 nu) / 15(1 - nu) for shape. The boundary is at a finite distance, so
    T / (1 - f + f T) with the volume fraction f (Mori & Tanaka 1973), which for volume
    is exact and for shape good to order f^2.
    """
    f = (RADIUS / FAR_MM) ** 3
    share = (1 + NU) / (3 * (1 - NU)), 2 * (4 - 5 * NU) / (15 * (1 - NU))
    dilute = [1 / (1 + s * (contrast - 1)) for s in share]
    volume, shape = (t / (1 - f + f * t) for t in dilute)
    return volume, shape


def graded(unit: FloatArray) -> FloatArray:
    """Return an eighth of a ball with shells at `SHELLS_MM`."""
    shell = unit.max(axis=1)
    wanted = np.interp(shell, np.linspace(0, 1, len(SHELLS_MM)), SHELLS_MM) / FAR_MM
    return ball(FAR_MM)(unit * (wanted / np.maximum(shell, 1e-300))[:, None])


def strain_inside(contrast: float, far: FloatArray) -> FloatArray:
    """Return the mean strain within half the radius if the outer sphere moves by `far` x, (3,)."""
    n = len(SHELLS_MM) - 1
    model = body([(n, n, n)], graded, bare=symmetric).finest
    lump = Inclusion(float(np.log(contrast)), (0.0, 0.0, 0.0), RADIUS)
    problem = Problem({Tissue.FAT: Constants(E, NU)}, NoPlates(), variations=(lump,))
    level = Level.build(model, problem)
    X = model.nodes
    outer = np.linalg.norm(X, axis=1) > FAR_MM - 1e-6
    level = holding(level, outer[:, None] | (np.abs(X) < 1e-9))
    result = minimise(level, State(X * (1 + far), 0.0), OPEN, solver_factory(()), 1e-9)
    assert result.reason == ""
    F = deformation_gradients(result.state.x, model.elements)
    centroid = X[model.elements.tets].mean(axis=1)
    core = np.linalg.norm(centroid, axis=1) < RADIUS / 2
    weight = model.elements.volumes[core]
    return np.einsum("e,eij->ij", weight, F[core] - np.eye(3)) / weight.sum()


@pytest.mark.parametrize("contrast", [10.0, 0.2])
def test_strain_inside_matches_eshelby(contrast):
    """Pulled along x; the surface of the ball is a surface of the mesh, smoothed over 1 mm."""
    e = 1e-4
    far = np.array([e, 0.0, 0.0])
    volume, shape = concentration(contrast)
    mean = far.mean()
    exact = volume * mean + shape * (far - mean)
    found = strain_inside(contrast, far)
    off = found - np.diag(np.diagonal(found))
    assert np.abs(off).max() < 0.01 * np.abs(exact).max()
    np.testing.assert_allclose(np.diagonal(found), exact, atol=0.04 * np.abs(exact).max())


def test_volume_strain_inside_matches_eshelby():
    e = 1e-4
    volume, _ = concentration(10.0)
    found = strain_inside(10.0, np.full(3, e))
    np.testing.assert_allclose(np.diagonal(found), volume * e, rtol=0.05)


@pytest.mark.parametrize("element_mm", [3.0, 200.0])
def test_constants_of_a_similar_body_change_only_around_lumps(element_mm):
    """Many elements in a lump, or a single one with all corners out of reach."""
    model = body([(20, 20, 20)], lambda unit: 20 * element_mm * unit).finest
    tissue = {Tissue.FAT: Constants(E, NU, fibre_mpa=2e-3, growth=1.2)}
    centres = model.centroids[[100, 20000, 40000]]
    lumps = tuple(Inclusion(0.5, tuple(map(float, centre)), 4.0) for centre in centres)
    before = element_constants(model, Problem(tissue, NoPlates(), variations=lumps[:2]))
    problem = Problem(tissue, NoPlates(), variations=lumps[1:])
    near = element_constants(model, problem, before)
    alone = element_constants(model, problem)
    assert near.problem is problem
    assert near.density is before.density
    for one, other in zip(near.material, alone.material, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)
    changed = np.flatnonzero(near.material.mu != before.material.mu)
    assert {100, 40000} <= set(changed)
    assert len(changed) < len(model.elements.tets) / 2

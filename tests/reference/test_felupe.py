"""A curved body between plates, against FElupe.

FElupe gets only the positions at which our plates hold the touching nodes. It must then find
the same body, and the same force on each of these nodes: penetration times penalty times
area.
"""

import numpy as np
import pytest

pytest.importorskip("felupe", reason="FElupe is not installed (pip install felupe)")

from palpate.storage.values import Tissue
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, build_hierarchy
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, Wall
from palpate.workers.mechanics.fem.plate_contact import PENALTY_N_PER_MM3
from tests.reference.bodies import half_ellipsoid
from tests.reference.felupe_body import solve_tets

CONSTANTS = {Tissue.FAT: Constants(0.01), Tissue.GLANDULAR: Constants(0.04)}
LOWER_MM, UPPER_MM = -22.0, 24.0


@pytest.fixture(scope="module")
def hierarchy() -> Hierarchy:
    return build_hierarchy(half_ellipsoid(core=0.5), nodes=1500)


@pytest.fixture(scope="module")
def model(hierarchy: Hierarchy) -> Model:
    return prepare(hierarchy)


def depth_mm(y: np.ndarray) -> np.ndarray:
    """Return the depth of points inside the upper plate, negative inside the lower one."""
    return np.maximum(y - UPPER_MM, 0) - np.maximum(LOWER_MM - y, 0)


def nodal_areas_mm2(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(nodes[triangles], 1, 0)
    share = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(triangles.ravel(), np.repeat(share, 3), len(nodes))


def test_curved_body_between_plates_matches_felupe(hierarchy: Hierarchy, model: Model) -> None:
    finest = hierarchy.finest
    mesh, tissue = finest.mesh, finest.fractions.argmax(axis=1)
    problem = Problem(
        CONSTANTS,
        DistanceControl(LOWER_MM, UPPER_MM),
        wall=Wall(held=(True, False, True)),
        plain_elements=True,
        tolerance_mm=1e-6,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    moved = solution.displacement_mm

    area = nodal_areas_mm2(mesh.nodes, finest.surface)
    depth = depth_mm(mesh.nodes[:, 1] + moved[:, 1]) * (area > 0)
    held = np.full(mesh.nodes.shape, np.nan)
    held[np.ix_(finest.wall, [0, 2])] = 0
    held[depth != 0, 1] = moved[depth != 0, 1]
    mu, kappa = (
        np.array([getattr(CONSTANTS[Tissue(t)], name) for t in tissue])
        for name in ("mu_mpa", "kappa_mpa")
    )
    answer = solve_tets(mesh, mu, kappa, held)

    away = np.linalg.norm(moved - answer.displacement_mm, axis=1)
    assert away.mean() < 1e-4
    assert away.max() < 5e-4
    pressed = -PENALTY_N_PER_MM3 * area * depth
    largest = np.abs(pressed).max()
    np.testing.assert_allclose(answer.force_n[:, 1], pressed, atol=1e-5 * largest)
    upper = answer.force_n[depth > 0, 1].sum()
    assert solution.outcome.plate_force_n == pytest.approx(-upper, rel=1e-5)

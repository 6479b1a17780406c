"""The half ellipsoid of ../shared/reference/febio, solved there by FEBio 4.11 (TET4).

The reference pins nine nodes at the lower plate; here the body may drift along x,
which is taken out before comparing. FEBio lets the plates in by 0.05-0.34 mm.
"""

from pathlib import Path

import numpy as np
import pytest

from storage.values import TetMesh, Tissue, Volume
from workers.fem.loads import DistanceControl, ForceControl
from workers.fem.model import Model, prepare
from workers.fem.problem import Constants, Problem
from workers.fem.solve import solve
from workers.mesh.hierarchy import Hierarchy, MeshLevel, build_hierarchy
from workers.mesh.node_sets import boundary_triangles, split_boundary
from workers.mesh.prolongation import prolongation

CASES = Path(__file__).parents[3] / "shared" / "reference" / "febio"
NEO_HOOKEAN = {
    Tissue.FAT: Constants(2 * 1.49 * 0.01275),
    Tissue.GLANDULAR: Constants(2 * 1.49 * 0.03675),
}

pytestmark = pytest.mark.skipif(
    not CASES.is_dir(), reason="the reference solutions of FEBio are not beside the project"
)


def case(name: str):
    return np.load(CASES / f"breast_5k__{name}.npz")


@pytest.fixture(scope="module")
def model() -> Model:
    """FEBio's own mesh, with coarser levels of ours below it."""
    found = case("nhF100")
    mesh = TetMesh(found["nodes"].astype(float), found["tets"].astype(np.int32))
    coarse = build_hierarchy(half_ellipsoid(), nodes=1500)
    wall = np.flatnonzero(mesh.nodes[:, 2] < 1e-6).astype(np.int32)
    fractions = np.zeros((len(mesh.tets), len(Tissue)), np.float32)
    glandular = found["label"] == 2
    fractions[np.arange(len(mesh.tets)), np.where(glandular, Tissue.GLANDULAR, Tissue.FAT)] = 1
    share = glandular.mean()
    levels = []
    for level in coarse.levels:
        mixed = np.zeros((len(level.mesh.tets), len(Tissue)), np.float32)
        mixed[:, [Tissue.FAT, Tissue.GLANDULAR]] = 1 - share, share
        levels.append(MeshLevel(level.mesh, mixed, level.wall, level.surface, level.prolongation))
    last = levels[-1]
    surface, _ = split_boundary(boundary_triangles(mesh.tets), wall)
    transfer = prolongation(last.mesh, last.wall, mesh.nodes, wall)
    levels.append(MeshLevel(mesh, fractions, wall, surface, transfer))
    return prepare(Hierarchy(tuple(levels)))


def half_ellipsoid() -> Volume:
    x, y, z = np.arange(-84, 85, 2.0), np.arange(-49, 50, 2.0), np.arange(1, 50, 2.0)
    inside = (
        (x[None, None] / 85) ** 2 + (y[None, :, None] / 50) ** 2 + (z[:, None, None] / 50) ** 2
    ) <= 1
    return Volume(inside.astype(np.uint8), (2.0, 2.0, 2.0), (x[0], y[0], z[0]))


def mean_difference_mm(solution, name: str) -> float:
    difference = solution.displacement_mm - case(name)["displacement"]
    difference[:, 0] -= difference[:, 0].mean()
    return float(np.linalg.norm(difference, axis=1).mean())


def test_force_control_with_the_same_element(model):
    problem = Problem(NEO_HOOKEAN, ForceControl(100, -50, 50), plain_elements=True)
    solution = solve(model, problem)
    assert solution.outcome.converged
    travel_mm = -case("nhF100")["curve"][-1, 1]
    assert solution.outcome.plate_displacement_mm == pytest.approx(travel_mm, rel=5e-3)
    assert mean_difference_mm(solution, "nhF100") < 0.1


@pytest.mark.parametrize(("name", "distance_mm"), [("nh40", 60.0), ("nh50", 50.0)])
def test_displacement_control_with_the_same_element(model, name, distance_mm):
    load = DistanceControl(-50, -50 + distance_mm)
    solution = solve(model, Problem(NEO_HOOKEAN, load, plain_elements=True))
    assert solution.outcome.converged
    force_n = -case(name)["curve"][-1, 2]
    assert solution.outcome.plate_force_n == pytest.approx(force_n, rel=0.02)
    assert mean_difference_mm(solution, name) < 0.15


def test_the_nodal_average_unlocks(model):
    """Linear tetrahedra lock by 0.1-3 % at nu = 0.49: unlocked, the plate goes farther."""
    load = ForceControl(100, -50, 50)
    plain = solve(model, Problem(NEO_HOOKEAN, load, plain_elements=True)).outcome
    averaged = solve(model, Problem(NEO_HOOKEAN, load)).outcome
    ratio = averaged.plate_displacement_mm / plain.plate_displacement_mm
    assert 1.001 < ratio < 1.03

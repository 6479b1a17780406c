"""The interface fit of a small breast has its optimum at the truth, and Gauss finds it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from palpate.service.bench.strategy_benchmark import Bench, study_of, targets
from palpate.workers.organs.breast.breast_organ import ORGAN

NAMES = ("E_fat", "eta_fat", "E_glandular", "eta_glandular")


@dataclass(frozen=True)
class _Breast:
    """A breast whose target was simulated with its own mesh."""

    equations_at: Any
    observation: Any
    displacement_mm: Any


@pytest.fixture(scope="module")
def breast() -> _Breast:
    """Return a breast, and a function from constants, over the true ones, to its equations."""
    spec = study_of("least-squares", 0, targets(10)[0], Bench(nodes=900, spacing_mm=2.0))
    case = spec.case
    body = ORGAN.make_body(case.reference)  # type: ignore[attr-defined]
    mesh = ORGAN.make_mesh(body, case)  # type: ignore[arg-type]
    model, ends = ORGAN.prepare(mesh), ORGAN.landmarks(body, case)  # type: ignore[arg-type]
    truth = case.complete(case.parameters.from_door(spec.target.constants or {}))
    problem = ORGAN.problem(model, case, truth, ends)  # type: ignore[arg-type]
    displacement = ORGAN.solve(model, problem).displacement_mm
    target = ORGAN.deform(body, mesh, displacement)
    observation = ORGAN.observation(body, mesh, target, False)

    def at(factors: Any) -> Any:
        constants = truth | {n: truth[n] * float(f) for n, f in zip(NAMES, factors, strict=True)}
        free = spec.free_parameters
        found = ORGAN.fit(model, case, constants, free, ends, None, observation)  # type: ignore[arg-type]
        assert found.residuals is not None
        return found.residuals.equations

    return _Breast(at, observation, displacement)


def test_the_distances_of_points_near_an_interface_vanish_at_the_truth(breast: _Breast) -> None:
    """Image and target are then the same voxels, and differ by no more than the distance map.

    Farther off they may: the two maps reach 4 mm and 25 mm, and beyond 1 mm the narrower one is
    not exact.
    """
    seen = breast.observation
    moved = seen.points.points + seen.at_points @ breast.displacement_mm
    of_target, _ = seen.compare(moved)
    of_image = seen.own_image(breast.displacement_mm)
    near = np.abs(of_image) < 0.6
    assert near.mean() > 0.5
    assert np.abs(of_target - of_image)[near].max() < 0.005


def test_the_sum_of_squares_is_far_smaller_at_the_truth(breast: _Breast) -> None:
    """It does not vanish, because of points farther from their interface than 1 mm."""
    afar = breast.equations_at([1.25, 0.8, 0.8, 1.25]).cost
    assert breast.equations_at([1, 1, 1, 1]).cost < 0.005 * afar


def test_three_steps_recover_the_moduli(breast: _Breast) -> None:
    """From 25 % off; the target has the same mesh, so voxels are the only error."""
    z = np.log([1.25, 0.8, 0.8, 1.25])
    costs = []
    for _ in range(3):
        e = breast.equations_at(np.exp(z))
        costs.append(e.cost)
        z = z - np.linalg.solve(e.hessian, e.gradient)
    assert np.abs(z[[0, 2]]).max() < 0.01
    assert np.abs(z).max() < 0.06
    assert costs[2] < 0.02 * costs[0]

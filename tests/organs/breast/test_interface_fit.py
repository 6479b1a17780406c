"""The interface fit of a small breast has its optimum at the truth, and Gauss finds it."""

from typing import Any

import numpy as np
import pytest

from service.strategy_bench import Bench, study_of, targets
from workers.organs.breast.organ import ORGAN

NAMES = ("E_fat", "eta_fat", "E_glandular", "eta_glandular")


@pytest.fixture(scope="module")
def fitted() -> Any:
    """Return a function from constants, over the true ones, to a least-squares problem."""
    spec = study_of("least-squares", 0, targets(10)[0], Bench(nodes=900, spacing_mm=2.0))
    case = spec.case
    body = ORGAN.make_body(case.reference)  # type: ignore[attr-defined]
    mesh = ORGAN.make_mesh(body, case)  # type: ignore[arg-type]
    model, ends = ORGAN.prepare(mesh), ORGAN.landmarks(body, case)  # type: ignore[arg-type]
    truth = case.complete(case.parameters.from_door(spec.target.constants or {}))
    problem = ORGAN.problem(model, case, truth, ends)  # type: ignore[arg-type]
    target = ORGAN.deform(body, mesh, ORGAN.solve(model, problem).displacement_mm)
    observation = ORGAN.observation(body, mesh, target, False)

    def at(factors: Any) -> Any:
        constants = truth | {n: truth[n] * float(f) for n, f in zip(NAMES, factors, strict=True)}
        free = spec.free_parameters
        found = ORGAN.fit(model, case, constants, free, ends, None, observation)  # type: ignore[arg-type]
        assert found.residuals is not None
        return found.residuals.equations

    return at


def test_the_sum_of_squares_is_least_at_the_truth(fitted: Any) -> None:
    """It does not vanish: far from its own interfaces a point's own distance is cut off."""
    afar = fitted([1.25, 0.8, 0.8, 1.25]).cost
    assert fitted([1, 1, 1, 1]).cost < 0.005 * afar


def test_three_steps_from_afar_find_the_moduli(fitted: Any) -> None:
    """From 25 % off; a target of the same mesh, so voxels are all that is lost."""
    z = np.log([1.25, 0.8, 0.8, 1.25])
    costs = []
    for _ in range(3):
        e = fitted(np.exp(z))
        costs.append(e.cost)
        z = z - np.linalg.solve(e.hessian, e.gradient)
    assert np.abs(z[[0, 2]]).max() < 0.01
    assert np.abs(z).max() < 0.06
    assert costs[2] < 0.02 * costs[0]

"""The curvature that Gauss-Newton neglects, estimated from the steps of a fit."""

import numpy as np
import pytest
from scipy.optimize import minimize

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits import gauss_newton
from palpate.workers.diagnosis.fits.gauss_newton import LocalModel, SecantCurvature
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, unknowns
from palpate.workers.diagnosis.problem.scan_prediction import ScanJacobian

P = 4
FREE = unknowns([FreeConstant(f"E_{i}", np.exp(-1.0), np.exp(1.0)) for i in range(P)], [])
"""Four parameters with means of zero and standard deviations of one."""


class Bent:
    """Residuals that are linear except for a large one that is curved: 30 + x' Q x / 4."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.A = rng.normal(0, 1, (20, P)) * [3.0, 2.0, 1.0, 0.5]
        self.b = rng.normal(0, 1, 20) + self.A @ rng.normal(0, 0.5, P)
        turn = np.linalg.qr(rng.normal(0, 1, (P, P)))[0]
        self.Q = turn @ np.diag([0.05, 0.5, 2.0, 20.0]) @ turn.T

    def residual(self, x):
        return np.append(self.A @ x - self.b, 30.0 + 0.25 * x @ self.Q @ x)

    def derivatives(self, x):
        return np.vstack([self.A, 0.5 * self.Q @ x])

    def cost(self, x):
        return float((self.residual(x) ** 2).sum() + x @ x)

    def missing(self, x):
        return 0.5 * self.residual(x)[-1] * self.Q

    def model(self, x):
        J, r = self.derivatives(x), self.residual(x)
        return LocalModel(J, r, J.T @ r + x, J.T @ J + np.eye(P))


def fitted(monkeypatch, bent, max_iterations=40):
    monkeypatch.setattr(gauss_newton, "_predict_scans", lambda i, u, z, *rest: ())
    monkeypatch.setattr(gauss_newton, "_starts", lambda *rest: [])
    monkeypatch.setattr(gauss_newton, "_cost", lambda i, u, z, p: bent.cost(z))
    monkeypatch.setattr(
        gauss_newton,
        "_jacobians",
        lambda i, u, z, *rest: [ScanJacobian(z, bent.derivatives(z), np.zeros((P, 1, 3)))],
    )
    monkeypatch.setattr(gauss_newton, "_local_model", lambda i, u, z, *rest: bent.model(z))
    start = np.array([0.8, -0.6, 0.7, 0.5])
    found = gauss_newton.fit(None, FREE, start, [], max_iterations=max_iterations)  # type: ignore[arg-type]
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(5))
def test_a_fit_with_large_residuals_converges(monkeypatch, seed):
    """It reaches the minimum found by another method, within the tolerance of the fit."""
    bent = Bent(seed)
    least = minimize(bent.cost, np.zeros(P), method="BFGS", options={"gtol": 1e-9}).fun
    found = fitted(monkeypatch, bent)
    assert found.converged
    assert found.cost - least < 0.1
    assert found.iterations <= 20


def test_plain_gauss_newton_crawls(monkeypatch):
    """Without the secant term, the same fits end farther from the optimum."""
    with_it = [fitted(monkeypatch, Bent(seed)) for seed in range(5)]
    monkeypatch.setattr(SecantCurvature, "renewed", lambda self, now: self)
    without = [fitted(monkeypatch, Bent(seed)) for seed in range(5)]
    assert sum(f.cost for f in without) > sum(f.cost for f in with_it) + 1.0


def test_secant_condition_holds():
    """Along the step, the model's gradient changes as the true gradient did."""
    bent = Bent(7)
    x, step = np.array([0.3, -0.2, 0.1, 0.2]), np.array([0.05, 0.02, -0.04, 0.01])
    before, after = bent.model(x), bent.model(x + step)
    fall = bent.cost(x) - bent.cost(x + step)
    learnt = SecantCurvature.unknown(P).stepped(before, step, fall).renewed(after)
    wanted = (after.columns - before.columns).T @ after.residual
    assert learnt.missing @ step == pytest.approx(wanted)
    assert np.allclose(learnt.missing, learnt.missing.T)
    # The gradient of the other residuals is linear here, so only the squared step is neglected.
    assert step @ learnt.missing @ step == pytest.approx(step @ bent.missing(x) @ step, rel=0.01)


def test_secant_term_is_used_if_it_predicts_better():
    bent = Bent(8)
    x, step = np.array([0.3, -0.2, 0.1, 0.2]), np.array([0.05, 0.02, -0.04, 0.01])
    first = SecantCurvature.unknown(P).stepped(bent.model(x), step, 1.0)
    assert not first.is_used
    learnt = first.renewed(bent.model(x + step))
    further = bent.cost(x + step) - bent.cost(x + 2 * step)
    assert learnt.stepped(bent.model(x + step), step, further).is_used
    linear = bent.model(x + step).fall(step)
    assert not learnt.stepped(bent.model(x + step), step, linear).is_used


def test_the_curvature_stays_positive_definite():
    model = Bent(9).model(np.zeros(P))
    saddle = SecantCurvature(-100.0 * np.eye(P), is_used=True)
    assert np.linalg.eigvalsh(saddle.curvature(model))[0] == pytest.approx(
        SETTINGS.fit.least_curvature
    )
    assert np.array_equal(SecantCurvature(saddle.missing).curvature(model), model.curvature)


def test_curvature_is_not_updated_without_derivatives():
    model = Bent(10).model(np.zeros(P))
    kept = SecantCurvature.unknown(P).stepped(model, np.ones(P), 1.0).forgotten()
    assert not kept.renewed(model).is_known

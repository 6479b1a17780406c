"""Step lengths of a fit, and its convergence."""

from collections.abc import Callable

import numpy as np
import pytest

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits import gauss_newton
from palpate.workers.diagnosis.fits.gauss_newton import LocalModel
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, Unknowns, unknowns
from palpate.workers.diagnosis.problem.scan_prediction import ScanJacobian

ONE = unknowns([FreeConstant("E_fat", np.exp(-1.0), np.exp(1.0))], [])
"""One parameter with a mean of zero and a standard deviation of one."""


def fitted(
    monkeypatch: pytest.MonkeyPatch,
    cost: Callable[[float], float],
    step: Callable[[float], float],
    expected: float,
) -> tuple[gauss_newton.SolvedFit, list[float]]:
    """Return a fit from 1 with given costs and steps, and the values tried."""
    tried: list[float] = []

    def predict(inverse: object, u: Unknowns, z: FloatArray, *rest: object) -> tuple[object, ...]:
        tried.append(float(z[0]))
        return ()

    columns, moved = np.ones((1, 1)), np.zeros((1, 1, 3))
    monkeypatch.setattr(gauss_newton, "_predict_scans", predict)
    monkeypatch.setattr(gauss_newton, "_starts", lambda *rest: [])
    monkeypatch.setattr(gauss_newton, "_cost", lambda i, u, z, p: cost(float(z[0])))
    monkeypatch.setattr(
        gauss_newton, "_jacobians", lambda i, u, z, *rest: [ScanJacobian(z, columns, moved)]
    )
    flat = LocalModel(np.zeros((1, 1)), np.zeros(1), np.zeros(1), np.ones((1, 1)))
    monkeypatch.setattr(gauss_newton, "_local_model", lambda *rest: flat)
    monkeypatch.setattr(
        gauss_newton, "_step", lambda u, z, *rest: (np.array([step(float(z[0]))]), expected)
    )
    found = gauss_newton.fit(None, ONE, np.array([1.0]), [])  # type: ignore[arg-type]
    assert found is not None
    return found, tried


def test_line_search_starts_near_the_last_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps are ten times too long; 0.16 of a step is the first that lowers a parabola."""
    found, tried = fitted(monkeypatch, lambda z: z * z, lambda z: -10 * z, expected=10.0)
    s = SETTINGS.fit.shortening
    lengths = [1.0, s, s**2, s, s**2, s, s**2]
    at, expected = 1.0, [1.0]
    for n, length in enumerate(lengths):
        expected.append(np.clip(at - 10 * length * at, ONE.lower[0], ONE.upper[0]))
        if n in (2, 4, 6):
            at = expected[-1]
    assert tried[: len(expected)] == pytest.approx(expected)
    assert found.cost < SETTINGS.fit.tolerance


def test_steps_lengthen_after_an_underestimated_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a decrease of 0.6 where 0.2 was expected, the next step is twice as long. Steps keep
    their length if decreases match the expectation."""
    _, tried = fitted(monkeypatch, lambda z: 3 * abs(z), lambda z: -0.2, expected=0.2)
    assert tried[:4] == pytest.approx([1.0, 0.8, 0.4, 0.0])
    _, tried = fitted(monkeypatch, lambda z: abs(z), lambda z: -0.2, expected=0.2)
    assert tried[:4] == pytest.approx([1.0, 0.8, 0.6, 0.4])


def test_a_crawling_fit_has_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost falls by a hundredth where a decrease of ten was expected."""
    found, tried = fitted(monkeypatch, lambda z: 0.01 * z, lambda z: -1.0, expected=10.0)
    assert tried == [1.0, 0.0]
    assert not found.converged
    at_rest, _ = fitted(monkeypatch, lambda z: 0.01 * z, lambda z: -1.0, expected=0.5)
    assert at_rest.converged

"""Intervals, ratios and directions of a least-squares problem with a known solution."""

import math

import numpy as np
import pytest

from palpate.service.results.identification import (
    identification_from_scatter,
    identification_from_tangents,
)
from palpate.service.results.intervals import SearchedConstants
from palpate.service.results.physical_limits import DEVIATIONS
from palpate.storage.values import FitJson
from palpate.workers.mechanics.model_parameters import BREAST

BOUNDS = {"E_fat": (0.005, 0.02), "eta_fat": (0.05, 0.2)}
BEST = {"E_fat": 0.01, "eta_fat": 0.1}


def fit(jacobian: np.ndarray, residual: np.ndarray, logarithmic: bool = True) -> FitJson:
    return {
        "parameters": list(BEST),
        "logarithmic": [logarithmic] * 2,
        "values": list(BEST.values()),
        "residuals": len(residual),
        "rms_mm": 0.1,
        "cost": float(residual @ residual),
        "gradient": (jacobian.T @ residual).tolist(),
        "hessian": (jacobian.T @ jacobian).tolist(),
        "noise": "a test",
    }


def orthogonal(m: int = 200) -> np.ndarray:
    """Return two orthonormal columns."""
    q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(m, 3)))
    return np.asarray(q)


def test_intervals_match_a_linear_model() -> None:
    q = orthogonal()
    jacobian = q[:, :2] * [100.0, 4.0]  # standard deviations of 1 % and 25 %
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 3, fit(jacobian, 10 * q[:, 2])
    )
    E, eta = found.constants["E_fat"], found.constants["eta_fat"]
    assert E.interval is not None and eta.interval is not None
    assert E.interval.lower == pytest.approx(10 * math.exp(-DEVIATIONS / 100))
    assert E.interval.upper == pytest.approx(10 * math.exp(DEVIATIONS / 100))
    assert eta.interval.upper == pytest.approx(100 * math.exp(DEVIATIONS / 4))
    assert (E.identifiable, eta.identifiable) == ("value", "weak")
    assert found.weak == ("eta_fat",)
    assert np.allclose(found.correlation, np.eye(2), atol=1e-12)
    assert found.directions[0].words == "E_fat alone, known to 1 %"
    assert found.directions[1].words == "eta_fat alone, known to 25 %"
    assert found.noise_factor == 1.0


def test_interval_covers_the_unfinished_part_of_the_search() -> None:
    q = orthogonal()
    jacobian = q[:, :2] * 100.0
    # The optimum is 5 % higher in E_fat.
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 0, fit(jacobian, -0.05 * jacobian[:, 0])
    )
    interval = found.constants["E_fat"].interval
    assert interval is not None
    assert interval.lower == pytest.approx(10 * math.exp(-DEVIATIONS / 100))
    assert interval.upper == pytest.approx(10 * math.exp(0.05 + DEVIATIONS / 100))


def test_residuals_beyond_the_noise_widen_the_intervals() -> None:
    q = orthogonal(203)
    residual = q[:, 2] * math.sqrt(4.0 * (203 - 2))
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 0, fit(q[:, :2] * 100.0, residual)
    )
    assert found.noise_factor == pytest.approx(2.0)
    interval = found.constants["E_fat"].interval
    assert interval is not None
    assert interval.upper == pytest.approx(10 * math.exp(2 * DEVIATIONS / 100))


def test_describes_a_trade_off_between_constants() -> None:
    q = orthogonal()
    size = math.hypot(0.3, 1.0)
    strong, weak = np.array([1.0, 0.3]) / size, np.array([-0.3, 1.0]) / size
    jacobian = np.outer(q[:, 0], strong) * 100 + np.outer(q[:, 1], weak) * 5
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 0, fit(jacobian, q[:, 2])
    )
    assert found.directions[-1].words == "eta_fat up by 10 % with E_fat down by 3 %, known to 19 %"
    assert found.correlation[0][1] < -0.5


def test_common_scale_identifies_only_ratios() -> None:
    q = orthogonal()
    jacobian = np.outer(q[:, 0], [-20.0, 20.0])  # only the ratio matters
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS, ("E_fat", "eta_fat")), 0, fit(jacobian, q[:, 2])
    )
    assert {c.identifiable for c in found.constants.values()} == {"ratio"}
    assert all(c.interval is None for c in found.constants.values())
    (ratio,) = found.ratios
    assert (ratio.numerator, ratio.denominator) == ("eta_fat", "E_fat")
    assert ratio.interval is not None
    assert ratio.interval.upper == pytest.approx(10 * math.exp(DEVIATIONS / 20))
    assert (
        found.directions[-1].words
        == "E_fat up by 10 % with eta_fat up by 10 %, not determined at all"
    )


def test_unidentified_constant_is_unknown() -> None:
    jacobian = orthogonal()[:, :2] * [100.0, 0.0]
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 0, fit(jacobian, np.zeros(200))
    )
    assert found.constants["eta_fat"].identifiable == "unknown"
    assert found.constants["E_fat"].identifiable == "value"


def test_unidentified_direction_widens_other_intervals() -> None:
    """A tenth of E depends on eta, which is unidentified in its whole searched interval."""
    jacobian = np.outer(orthogonal()[:, 0], [100.0, 10.0])
    found = identification_from_tangents(
        SearchedConstants(BREAST, BOUNDS), 0, fit(jacobian, np.zeros(200))
    )
    interval = found.constants["E_fat"].interval
    assert interval is not None
    width = [math.log(upper / lower) for lower, upper in BOUNDS.values()]
    along = math.sqrt((0.01 * width[0] ** 2 + width[1] ** 2) / 1.01 / 12)
    share = 0.1 / math.sqrt(1.01)
    reach = math.log(interval.upper / interval.lower) / 2
    assert reach == pytest.approx(DEVIATIONS * math.hypot(share * along, 0.01), rel=0.01)


def test_scatter_replaces_missing_derivatives() -> None:
    searched = SearchedConstants(BREAST, BOUNDS)
    alike = [{"E_fat": 0.01 * (1 + k / 100), "eta_fat": 0.05 + 0.01 * k} for k in range(11)]
    found = identification_from_scatter(searched, 7, BEST, alike, "no tangents here")
    E, eta = found.constants["E_fat"], found.constants["eta_fat"]
    assert E.interval is not None
    assert E.interval.origin == "scatter of equally good candidates"
    assert E.interval.lower == pytest.approx(10.0)  # it always contains the best candidate
    assert E.interval.upper == pytest.approx(10.95)
    assert (E.identifiable, eta.identifiable) == ("value", "weak")
    few = identification_from_scatter(searched, 7, BEST, alike[:4], "too few")
    assert {c.identifiable for c in few.constants.values()} == {"unknown"}

"""Draws from the posterior of the constants reproduce the reported intervals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.service.results.identification import LEVEL, identification_from_tangents
from palpate.service.results.intervals import LocalModel, Posterior, SearchedConstants
from palpate.service.results.posterior_samples import Samples, constants_with_samples, draw_samples
from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_from_journal import study_results
from palpate.storage.errors import InputError
from palpate.workers.mechanics.model_parameters import BREAST
from tests.recovery.stand_ins import Inline, run
from tests.recovery.test_strategies import spec_of
from tests.service.results.test_identification import BOUNDS, fit, orthogonal

N = 20_000
QUANTILES = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
# The 5 % quantile of n normal draws scatters by 2.1 sd / sqrt(n), and an interval is 3.3 sd wide:
# five such errors, relative to its width.
TOLERANCE = 5 * 2.1 / 3.3 / N**0.5


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    folder = tmp_path_factory.mktemp("samples") / "runs" / "demo"
    run(folder, Inline(), spec_of("least-squares"))
    return study_results(folder)


def assert_same_interval(draws: np.ndarray, interval: tuple[float, float]) -> None:
    found = np.quantile(draws, QUANTILES)
    assert np.abs(found - interval).max() < TOLERANCE * (interval[1] - interval[0])


def test_quantiles_match_the_interval_ends(results: StudyResults) -> None:
    samples = draw_samples(results, N, seed=1)
    assert list(samples) == ["E_fat_kpa", "E_glandular_kpa"]
    for estimate in results.estimates.values():
        assert estimate.interval is not None
        assert_same_interval(samples[estimate.gene], estimate.interval)


@pytest.mark.parametrize("logarithmic", [True, False])
def test_quantiles_match_intervals_off_the_best_candidate(logarithmic: bool) -> None:
    """The optimum is 1.5 standard deviations above the candidate in one constant."""
    q = orthogonal()
    scale = np.ones(2) if logarithmic else np.array([np.ptp(b) for b in BOUNDS.values()])
    jacobian = (q[:, :2] @ [[100.0, 30.0], [0.0, 20.0]]) / scale
    problem = fit(jacobian, -0.015 * jacobian[:, 0] * scale[0] + q[:, 2], logarithmic)
    searched = SearchedConstants(BREAST, BOUNDS)
    stated = identification_from_tangents(searched, 0, problem).constants
    drawn = Posterior(LocalModel(problem, searched), searched).draw(list(BOUNDS), N, 2)
    for draws, constant in zip(drawn, stated.values(), strict=True):
        assert constant.interval is not None
        assert_same_interval(draws, (constant.interval.lower, constant.interval.upper))


def test_draws_have_the_correlation_of_the_errors() -> None:
    jacobian = orthogonal()[:, :2] @ [[100.0, 60.0], [0.0, 40.0]]
    problem, searched = fit(jacobian, np.zeros(200)), SearchedConstants(BREAST, BOUNDS)
    local = LocalModel(problem, searched)
    drawn = Posterior(local, searched).draw(list(BOUNDS), N, 3)
    found = np.corrcoef(np.log(drawn))[0, 1]
    assert found == pytest.approx(local.correlation[0][1], abs=0.03)
    assert found < -0.7


def test_draws_are_admissible() -> None:
    """Poisson's ratio and its interval end at one half."""
    bounds = {"E_fat": (0.005, 0.02), "nu": (0.3, 0.4999)}
    problem = fit(orthogonal()[:, :2] * 100.0, np.zeros(200))
    problem |= {"parameters": list(bounds), "values": [0.01, 0.495]}  # type: ignore[typeddict-item]
    searched = SearchedConstants(BREAST, bounds)
    (nu,) = Posterior(LocalModel(problem, searched), searched).draw(["nu"], N, 4)
    interval = identification_from_tangents(searched, 0, problem).constants["nu"].interval
    assert interval is not None
    assert nu.max() == BREAST["nu"].admissible[1] == interval.upper


def test_draws_depend_on_the_seed_but_not_on_the_selection(results: StudyResults) -> None:
    both = draw_samples(results, 50, seed=5)
    (fat,) = draw_samples(results, 50, seed=5, constants=["E_fat"]).values()
    assert np.array_equal(fat, both["E_fat_kpa"])
    assert not np.array_equal(draw_samples(results, 50, seed=6)["E_fat_kpa"], fat)


def test_rejects_constants_without_an_interval(results: StudyResults) -> None:
    weak = replace(results.estimates["E_fat"], interval=None)
    partly = replace(results, estimates={**results.estimates, "E_fat": weak})
    with pytest.raises(InputError, match=r"E_fat_kpa has no interval.*\['E_glandular_kpa'\]"):
        draw_samples(partly)
    assert list(draw_samples(partly, 10, constants=["E_glandular_kpa"])) == ["E_glandular_kpa"]
    assert constants_with_samples(partly) == ["E_glandular"]
    with pytest.raises(InputError, match="did you mean 'E_fat_kpa'"):
        draw_samples(results, constants=["E_fatt_kpa"])
    with pytest.raises(InputError, match="at least 1"):
        draw_samples(results, 0)
    with pytest.raises(InputError, match="scatter of equally good candidates"):
        draw_samples(replace(results, posterior=None))


def test_unconverged_study_has_no_samples(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline())
    with pytest.raises(InputError, match=r"E_fat_kpa has no interval.*has not converged"):
        draw_samples(study_results(folder))


def test_xarray_format_matches_arviz(results: StudyResults) -> None:
    pytest.importorskip("xarray", reason="xarray is not installed: pip install .[data]")
    samples = draw_samples(results, 30)
    made = samples.to_xarray()
    assert made["E_fat_kpa"].dims == ("chain", "draw")
    assert made["E_fat_kpa"].shape == (1, 30)
    assert made["E_fat_kpa"].attrs == {"units": "kPa"}
    assert np.array_equal(made["E_glandular_kpa"].values[0], samples["E_glandular_kpa"])
    assert list(samples.to_frame().columns) == list(samples)


def test_repr_of_samples_is_short() -> None:
    draws = {f"a_very_long_name_of_a_constant_{i}": np.ones(3) for i in range(30)}
    assert len(repr(Samples(draws, {}, "study", 0))) < 500

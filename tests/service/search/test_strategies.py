"""All strategies on a problem with a known least-squares solution: a stiffening spring.

The spring's force is E x + eta x^3. Its forces at twelve stretches are the data, so the sum
of squares vanishes only at the true constants.
"""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from palpate.service.search.cma_search import CmaSearch, CmaSettings
from palpate.service.search.genetic_search import GeneticSearch, GeneticSettings
from palpate.service.search.least_squares_search import (
    NEW_STARTS,
    FittedNames,
    LeastSquaresSearch,
    LeastSquaresSettings,
    PolishedSearch,
)
from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    Proposal,
    Search,
    Space,
    Stopped,
)
from palpate.storage.values import FitJson
from tests.service.search.boxes import contains

SPACE = Space.from_bounds({"E_kpa": (5, 80), "eta_kpa": (50, 200)})
# One internal unit is 1000 external ones.
NAMES = FittedNames(("E", "eta"), (1000.0, 1000.0))
TRUTH = np.array([33.0, 120.0])
STRETCHES = np.linspace(0.1, 1.0, 12)
NOISE = 0.05

Forces = Callable[[FloatArray], FloatArray]


def forces(genes: FloatArray) -> FloatArray:
    return np.asarray(genes[0] * STRETCHES + genes[1] * STRETCHES**3)


DATA = forces(TRUTH)


def fit_of(genes: FloatArray, data: FloatArray = DATA) -> FitJson:
    r = (forces(genes) - data) / NOISE
    # By logarithms; the order (eta, E) differs from the search's on purpose.
    j = np.stack([genes[1] * STRETCHES**3, genes[0] * STRETCHES], axis=1) / NOISE
    return {
        "parameters": ["eta", "E"], "logarithmic": [True, True],
        "values": [genes[1] / 1000, genes[0] / 1000], "residuals": len(r), "rms_mm": 0.0,
        "cost": float(r @ r), "gradient": (j.T @ r).tolist(), "hessian": (j.T @ j).tolist(),
        "noise": "",
    }  # fmt: skip


def followed(
    search: Search, data: FloatArray = DATA, fails: Sequence[int] = (), most: int = 200
) -> tuple[list[Generation], list[Proposal], str]:
    """Run a search to its end; the evaluations numbered in `fails` do not converge."""
    history: list[Generation] = []
    proposals: list[Proposal] = []
    count = 0
    while isinstance(proposal := search.propose(history), Proposal):
        scores, fits = {}, {}
        for i in proposal.to_evaluate:
            fit = None if count in fails else fit_of(proposal.genes[i], data)
            scores[i] = np.inf if fit is None else float(np.log(fit["cost"] + 1e-12))
            fits[i] = fit if proposal.derivatives else None
            count += 1
        backwards = dict(reversed(scores.items()))  # the order of arrival does not matter
        history.append(proposal.complete(backwards, history, fits))
        proposals.append(proposal)
        assert count < most
    return history, proposals, proposal.reason


def best_of(history: Sequence[Generation]) -> FloatArray:
    best = min(history, key=lambda g: float(g.scores.min()))
    return best.genes[best.best]


def least_squares(starts: int = 3, levels: int = 0) -> LeastSquaresSearch:
    return LeastSquaresSearch(SPACE, NAMES, LeastSquaresSettings(starts, levels), seed=5)


def genetic() -> GeneticSearch:
    return GeneticSearch(SPACE, GeneticSettings(population=12, generations=3), seed=5)


STRATEGIES: dict[str, Callable[[], Search]] = {
    "least-squares": least_squares,
    "genetic+least-squares": lambda: PolishedSearch(genetic(), least_squares(2)),
    "cma": lambda: CmaSearch(SPACE, CmaSettings(8, 20, None), 5),
}


@pytest.mark.parametrize("name", STRATEGIES)
def test_a_search_is_a_fold_over_its_history(name: str) -> None:
    history, proposals, _ = followed(STRATEGIES[name]())
    for k, proposal in enumerate(proposals):
        again = STRATEGIES[name]().propose(history[:k])
        assert isinstance(again, Proposal)
        assert np.array_equal(again.genes, proposal.genes)
        assert (again.level, again.derivatives) == (proposal.level, proposal.derivatives)
        assert contains(SPACE, proposal.genes)


@pytest.mark.parametrize("name", STRATEGIES)
def test_strategies_recover_the_true_constants(name: str) -> None:
    history, _, _ = followed(STRATEGIES[name]())
    assert best_of(history) == pytest.approx(TRUTH, rel=2e-2 if name == "cma" else 1e-3)


def test_a_fit_takes_few_evaluations_and_its_starts_merge() -> None:
    history, _, reason = followed(least_squares())
    assert sum(len(g.genes) for g in history) <= 15
    assert [len(g.genes) for g in history] == sorted((len(g.genes) for g in history), reverse=True)
    assert reason == "no step of the fit promises a smaller sum of squared distances"


def test_optimum_outside_the_box_is_fitted_on_its_bound() -> None:
    """With a larger eta in the data, only E can explain the rest."""
    data = forces(np.array([33.0, 230.0]))
    history, _, _ = followed(least_squares(1), data)
    found = history[-1].genes[0]
    assert found[1] == pytest.approx(200.0)
    cubes = data - 200.0 * STRETCHES**3
    assert found[0] == pytest.approx(cubes @ STRETCHES / (STRETCHES @ STRETCHES), rel=1e-3)


def test_failed_start_is_redrawn() -> None:
    history, proposals, _ = followed(least_squares(), fails=[1])
    undisturbed = followed(least_squares())[1]
    assert len(proposals[0].genes) == len(proposals[1].genes) == 3
    assert np.array_equal(proposals[1].genes[[0, 2]], undisturbed[1].genes[[0, 2]])
    assert not np.allclose(proposals[1].genes[1], undisturbed[1].genes[1])
    assert best_of(history) == pytest.approx(TRUTH, rel=1e-3)


def test_fit_stops_if_no_start_can_be_simulated() -> None:
    _, proposals, reason = followed(least_squares(), fails=range(100))
    assert [len(p.genes) for p in proposals] == [3] * (NEW_STARTS + 1)
    assert reason == "no start of the fit could be simulated"


def test_failed_step_is_shortened() -> None:
    history, _, _ = followed(least_squares(1), fails=[1])
    start, tried, shorter = (g.genes[0] for g in history[:3])
    assert np.abs(np.log(shorter / start)).max() < 0.3 * np.abs(np.log(tried / start)).max()
    assert history[-1].genes[0] == pytest.approx(TRUTH, rel=1e-3)


def test_finer_levels_begin_where_the_coarser_ones_end() -> None:
    history, proposals, _ = followed(least_squares(3, levels=2))
    levels = [p.level for p in proposals]
    assert list(dict.fromkeys(levels)) == [0, 1, None]
    for level, finer in ((0, 1), (1, None)):
        last = levels.index(finer)
        before = [g for g, at in zip(history, levels, strict=True) if at == level]
        assert len(proposals[last].genes) == 1
        assert np.allclose(proposals[last].genes[0], best_of(before), rtol=1e-12)


def test_genetic_part_of_a_polished_search_equals_the_genetic_search() -> None:
    alone, _, _ = followed(genetic())
    polished, proposals, _ = followed(STRATEGIES["genetic+least-squares"]())
    assert len(polished) > len(alone)
    for a, b in zip(alone, polished, strict=False):
        assert np.array_equal(a.genes, b.genes)
    assert [p.derivatives for p in proposals] == [False] * len(alone) + [True] * (
        len(polished) - len(alone)
    )
    assert isinstance(STRATEGIES["genetic+least-squares"]().propose(polished), Stopped)

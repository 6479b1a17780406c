"""Additions of a study to its strategy: start points, scales, constraints and stop rules."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from palpate.service.search.constraints import Constraint, Constraints
from palpate.service.search.least_squares_search import FittedNames
from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    LogScale,
    Proposal,
    Search,
)
from palpate.service.search.search_keys import SearchRequest, SearchSpec, strategy_named
from palpate.storage.errors import InputError
from palpate.testing import check_search
from palpate.workers.common_keys import validated

BOUNDS = {"E_fat_kpa": [5, 80], "E_glandular_kpa": [5, 80]}
TRUTH = np.array([12.0, 47.0])
START = {"E_fat_kpa": 11.5, "E_glandular_kpa": 44.0}


def spec(**keys: Any) -> SearchSpec:
    given = {"parameters": BOUNDS, "population": 12, "generations": 6, **keys}
    return validated(SearchSpec, given, "The search")


def request(search: SearchSpec) -> SearchRequest:
    names = FittedNames(("E_fat", "E_glandular"), (1e3, 1e3))
    return SearchRequest(search, names, 0, 3)


def made(search: SearchSpec) -> Search:
    return strategy_named(search.strategy).make(request(search))


def followed(search: Search) -> list[Generation]:
    """Run a search to its end on a valley in logarithms."""
    history: list[Generation] = []
    while isinstance(proposal := search.propose(history), Proposal):
        scores = np.sum(np.log(proposal.genes / TRUTH) ** 2, axis=1)
        told = {i: float(scores[i]) for i in proposal.to_evaluate}
        history.append(proposal.complete(told, history))
    return history


def first(search: Search) -> FloatArray:
    proposal = search.propose([])
    assert isinstance(proposal, Proposal)
    return proposal.genes


@pytest.mark.parametrize("scale", [{}, {"E_fat_kpa": "log"}])
def test_a_genetic_search_begins_with_the_given_points(scale: dict[str, str]) -> None:
    other = {"E_fat_kpa": 5.0, "E_glandular_kpa": 80.0}
    genes = first(made(spec(start=[START, other], scale=scale)))
    np.testing.assert_allclose(genes[:2], [[11.5, 44.0], [5.0, 80.0]], rtol=1e-15)
    np.testing.assert_array_equal(genes[2:], first(made(spec(scale=scale)))[2:])


def test_descents_begin_at_the_given_points() -> None:
    genes = first(made(spec(strategy="least-squares", starts=3, start=[START])))
    np.testing.assert_allclose(genes[0], [11.5, 44.0], rtol=1e-12)
    np.testing.assert_array_equal(
        genes[1:], first(made(spec(strategy="least-squares", starts=3)))[1:]
    )


def test_cma_draws_around_the_given_point() -> None:
    middles = [first(made(spec(strategy="cma", population=400, start=s))) for s in ([], [START])]
    near = [np.exp(np.mean(np.log(genes), axis=0)) for genes in middles]
    np.testing.assert_allclose(near[0], [20.0, 20.0], rtol=0.1)
    # Draws beyond the lower bound are reflected.
    assert abs(np.log(near[1] / [11.5, 44.0])).max() < 0.3


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"start": [{"E_fat_kpa": 10}]}, "one value of each searched parameter"),
        ({"start": [{"E_fat_kpa": 90, "E_glandular_kpa": 9}]}, r"outside its bounds \[5, 80\]"),
        ({"start": [START] * 2, "strategy": "cma"}, "takes 1"),
        ({"start": [START] * 4, "strategy": "least-squares"}, "takes 3"),
        ({"scale": {"E_skin_kpa": "log"}}, "E_skin_kpa is not searched"),
        ({"scale": {"E_fat_kpa": "log"}, "strategy": "cma"}, "not supported by strategy"),
        ({"constraints": ["E_fat_kpa = 3"]}, "expected NAME > NAME"),
        ({"constraints": ["E_fat_kpa > E_skin_kpa"]}, "E_skin_kpa is not searched"),
        ({"constraints": ["E_fat_kpa > E_fat_kpa"]}, "does not compare two"),
        ({"constraints": ["E_fat_kpa > 17 E_glandular_kpa"]}, "no candidate within the bounds"),
        (
            {"constraints": ["E_fat_kpa > E_glandular_kpa"], "strategy": "least-squares"},
            "not supported by strategy",
        ),
        ({"mode": "steady", "scale": {"E_fat_kpa": "log"}}, "need mode: barrier"),
        ({"mode": "steady", "stop": {"score": -3}}, "need mode: barrier"),
        ({"stop": {"evaluations": 0}}, "stop.evaluations"),
    ],
)
def test_rejects_inconsistent_keys(keys: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        spec(**keys)


def test_rejects_a_logarithmic_scale_from_zero() -> None:
    with pytest.raises(InputError, match="has no logarithm"):
        spec(parameters={"friction": [0, 1]}, scale={"friction": "log"})


def test_a_logarithmic_scale_draws_logarithms() -> None:
    linear, log = (
        first(made(spec(population=2000, scale=scale)))
        for scale in ({}, {"E_fat_kpa": "log", "E_glandular_kpa": "linear"})
    )
    np.testing.assert_allclose(np.median(linear, axis=0), [42.5, 42.5], rtol=0.05)
    np.testing.assert_allclose(np.median(log, axis=0), [20.0, 42.5], rtol=0.05)
    both = LogScale(spec().space, {"E_fat_kpa"})
    np.testing.assert_allclose(both.outer(both.to_inner(log)), log, rtol=1e-14)


def test_elites_on_a_logarithmic_scale_are_bit_identical() -> None:
    history = followed(made(spec(scale={"E_fat_kpa": "log"})))
    for before, after in pairwise(history):
        best = before.genes[before.ranking[:2]]
        np.testing.assert_array_equal(after.genes[:2], best)


@pytest.mark.parametrize("strategy", ["genetic", "cma"])
def test_all_candidates_satisfy_the_constraints(strategy: str) -> None:
    search = spec(strategy=strategy, constraints=["E_glandular_kpa > 2 * E_fat_kpa"])
    genes = np.concatenate([g.genes for g in followed(made(search))])
    assert (genes[:, 1] >= 2 * genes[:, 0] - 1e-9).all()
    free = np.concatenate([g.genes for g in followed(made(spec(strategy=strategy)))])
    assert (free[:, 1] < 2 * free[:, 0]).any()


def test_violating_candidates_move_to_the_nearest_point() -> None:
    box = Constraints(spec().space, [Constraint.parse("E_fat_kpa <= E_glandular_kpa")])
    given = np.array([[60.0, 20.0], [10.0, 70.0], [80.0, 5.0]])
    np.testing.assert_allclose(box.nearest(given), [[40, 40], [10, 70], [42.5, 42.5]])


@pytest.mark.parametrize(
    "keys",
    [
        {"start": [START], "scale": {"E_fat_kpa": "log", "E_glandular_kpa": "log"}},
        {"constraints": ["E_glandular_kpa > E_fat_kpa"], "stop": {"evaluations": 40}},
    ],
)
def test_wrapped_searches_are_pure_functions_of_the_generations(keys: dict[str, Any]) -> None:
    renamed = {"E_fat_kpa": "E_kpa", "E_glandular_kpa": "eta_kpa"}
    bounds = {"E_kpa": [5, 80], "eta_kpa": [50, 200]}
    keys = dict(keys)
    if "start" in keys:
        keys["start"] = [{"E_kpa": 30, "eta_kpa": 100}]
        keys["scale"] = {renamed[name]: scale for name, scale in keys["scale"].items()}
    else:
        keys["constraints"] = ["eta_kpa > E_kpa"]
    search = validated(
        SearchSpec, {"parameters": bounds, "population": 12, "generations": 5, **keys}, ""
    )
    check_search(strategy_named("genetic"), search)

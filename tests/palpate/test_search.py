"""`palpate.Search`: the ask-and-tell interface for arbitrary functions."""

import math

import pytest

import palpate
import palpate.search

BOUNDS = {"x": (0.5, 4.0), "y": (0.0, 4.0)}


def valley(candidate: dict[str, float]) -> float:
    return (candidate["x"] - 1) ** 2 + (candidate["y"] - 3) ** 2


def followed(search: palpate.Search) -> list[dict[str, float]]:
    seen = []
    while candidates := search.ask():
        assert search.ask() == candidates
        seen += candidates
        search.tell([valley(c) for c in candidates])
    return seen


@pytest.mark.parametrize("strategy", ["genetic", "cma"])
def test_finds_minimum_reproducibly(strategy: str) -> None:
    searches = [palpate.Search(BOUNDS, strategy, 3, population=16, generations=25) for _ in "ab"]
    assert followed(searches[0]) == followed(searches[1])
    one = searches[0]
    assert one.best_score == valley(one.best) < 0.01
    assert one.stopped
    assert one.ask() == []


def test_settings_of_a_study_file_apply() -> None:
    start = {"x": 1.5, "y": 2.5}
    search = palpate.Search(
        BOUNDS, start=[start], constraints=["y > 2 * x"], stop={"score": 0.3}, population=12
    )
    seen = followed(search)
    assert seen[0] == pytest.approx({"x": 1.4, "y": 2.8}, abs=0.3)  # moved into the constraint
    assert all(c["y"] >= 2 * c["x"] - 1e-9 for c in seen)


def test_failed_candidates_are_not_best() -> None:
    search = palpate.Search(BOUNDS, population=6, generations=2)
    assert (search.best, search.best_score) == ({}, math.inf)
    search.tell([math.nan, math.inf, 3.0, 2.0, math.inf, math.nan])
    assert search.best_score == 2.0


def test_rejects_invalid_settings() -> None:
    with pytest.raises(palpate.InputError, match="supports neither derivatives"):
        palpate.Search(BOUNDS, "least-squares")
    with pytest.raises(palpate.InputError, match="populaton"):
        palpate.Search(BOUNDS, populaton=3)
    with pytest.raises(palpate.InputError, match="Expected 84 scores, found 1"):
        palpate.Search(BOUNDS).tell([1.0])

"""The operators: exact expectations and selection, children within bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.service.search.genetic_operators import (
    INITIAL,
    MUTATIONS,
    AdaptiveFeasible,
    BreedingProgress,
    Gaussian,
    Mutation,
    latin_hypercube,
    rank_expectation,
    reflect,
    scattered_crossover,
    stochastic_uniform,
    uniform_population,
)
from palpate.service.search.search_interface import Space
from palpate.storage.errors import InputError
from tests.service.search.boxes import contains

BOX = Space(("a", "b", "c"), (-1.0, 50.0, 1e-3), (1.0, 200.0, 2e-3))
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(2, 90)


def progress(*bests: float, generations: int = 15) -> BreedingProgress:
    return BreedingProgress(len(bests), generations, np.array(bests))


# --- expectation -------------------------------------------------------------


def test_expectation_of_three_matches_hand_calculation() -> None:
    # 1/sqrt(1), 1/sqrt(2), 1/sqrt(3) = 1, 0.707107, 0.577350; sum 2.284457; times 4 parents
    expectation = rank_expectation(np.array([2, 0, 1]), 4)
    assert expectation == pytest.approx([1.238118, 1.010919, 1.750963], abs=1e-6)


def test_expectation_of_the_thesis() -> None:
    # sum_{r=1}^{84} r^(-1/2) = 16.925..., so the best of 84 is 148 / 16.925 = 8.74 parents
    expectation = rank_expectation(np.arange(84), 148)
    assert expectation.sum() == pytest.approx(148, rel=1e-14)
    assert expectation[0] == pytest.approx(148 / sum(r**-0.5 for r in range(1, 85)), rel=1e-14)
    assert expectation[0] / expectation[24] == pytest.approx(5, rel=1e-14)


# --- selection ---------------------------------------------------------------


@settings(deadline=None)
@given(seeds, sizes, st.integers(1, 200))
def test_selection_counts_are_floor_or_ceil_of_the_expectation(
    seed: int, size: int, parents: int
) -> None:
    rng = np.random.default_rng(seed)
    expectation = rank_expectation(rng.permutation(size), parents)
    chosen = stochastic_uniform(rng, expectation, parents)
    counts = np.bincount(chosen, minlength=size)
    assert counts.sum() == parents
    assert (counts >= np.floor(expectation - 1e-9)).all()
    assert (counts <= np.ceil(expectation + 1e-9)).all()


def test_selection_is_unbiased() -> None:
    expectation = rank_expectation(np.array([3, 1, 0, 2, 4]), 7)
    rng = np.random.default_rng(5)
    draws = 4000
    counts = sum(
        np.bincount(stochastic_uniform(rng, expectation, 7), minlength=5) for _ in range(draws)
    )
    # A count is floor or floor + 1, so its standard deviation is 1/2 at most: 5 sigma.
    assert np.asarray(counts) / draws == pytest.approx(expectation, abs=5 * 0.5 / draws**0.5)


def test_shuffling_avoids_pairs_of_equal_rank() -> None:
    """Without the shuffle, parents would be in index order and pair with themselves."""
    rng = np.random.default_rng(0)
    chosen = stochastic_uniform(rng, rank_expectation(np.arange(84), 148), 148)
    assert (np.diff(chosen) < 0).any()
    best_with_itself = np.mean((chosen[0::2] == 0) & (chosen[1::2] == 0))
    assert best_with_itself < 0.05


# --- crossover ---------------------------------------------------------------


@settings(deadline=None)
@given(seeds, st.integers(1, 60))
def test_every_gene_of_a_child_is_a_parents_gene(seed: int, pairs: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.random((2, pairs, 4))
    child = scattered_crossover(rng, first, second)
    assert np.logical_or(child == first, child == second).all()


def test_genes_come_from_either_parent_with_even_odds() -> None:
    rng = np.random.default_rng(1)
    zeros = np.zeros((10_000, 4))
    share = scattered_crossover(rng, zeros, zeros + 1).mean(axis=0)
    assert share == pytest.approx(0.5, abs=5 * 0.5 / 100)


# --- initial population ------------------------------------------------------


@pytest.mark.parametrize("name", INITIAL)
def test_initial_population_fills_the_box(name: str) -> None:
    genes = INITIAL[name](np.random.default_rng(2), 400, BOX)
    assert genes.shape == (400, 3)
    assert contains(BOX, genes)
    unit = BOX.to_unit(genes)
    # Mean and variance of a uniform variable: 1/2 and 1/12.
    assert unit.mean(axis=0) == pytest.approx(0.5, abs=5 * (1 / 12) ** 0.5 / 20)
    assert unit.var(axis=0) == pytest.approx(1 / 12, rel=0.2)
    assert abs(np.corrcoef(unit.T) - np.eye(3)).max() < 0.25


@settings(deadline=None)
@given(seeds, sizes)
def test_each_slice_of_a_latin_hypercube_holds_one_point(seed: int, size: int) -> None:
    unit = Space(("a", "b"), (0, 0), (1, 1))
    points = latin_hypercube(np.random.default_rng(seed), size, unit)
    slices = np.sort(np.floor(points * size), axis=0)
    assert np.array_equal(slices, np.tile(np.arange(size)[:, None], (1, 2)))


def test_uniform_population_is_not_stratified() -> None:
    unit = Space(("a",), (0,), (1,))
    points = uniform_population(np.random.default_rng(0), 40, unit)
    assert len(np.unique(np.floor(points * 40))) < 40


# --- mutation ----------------------------------------------------------------


def test_reflection_matches_hand_calculation() -> None:
    #  0.25 stays; -0.25 -> 0.25; 1.25 -> 0.75; 2.25 -> 0.25; -1.25 -> 0.75
    points = np.array([0.25, -0.25, 1.25, 2.25, -1.25, 0.0, 1.0])
    assert reflect(points).tolist() == [0.25, 0.25, 0.75, 0.25, 0.75, 0.0, 1.0]


@settings(deadline=None)
@given(seeds, st.sampled_from(sorted(MUTATIONS)), st.integers(0, 14))
def test_children_stay_within_bounds_even_from_a_corner(seed: int, name: str, age: int) -> None:
    rng = np.random.default_rng(seed)
    corners = BOX.from_unit(rng.integers(0, 2, size=(16, 3)).astype(np.float64))
    parents = np.concatenate([corners, uniform_population(rng, 4, BOX)])
    bests = np.minimum.accumulate(rng.standard_normal(age))
    children = MUTATIONS[name](rng, parents, BOX, BreedingProgress(age, 15, bests))
    assert children.shape == parents.shape
    assert contains(BOX, children)
    assert not np.array_equal(children, parents)


def test_step_of_adaptive_mutation_matches_hand_calculation() -> None:
    mutation = AdaptiveFeasible(initial=0.25, smallest=0.01, largest=0.5, grow=2, shrink=0.25)
    inf = np.inf
    assert mutation.step(np.array([5.0])) == 0.25
    assert mutation.step(np.array([5.0, 4.0])) == 0.5
    assert mutation.step(np.array([5.0, 4.0, 3.0])) == 0.5  # the largest
    assert mutation.step(np.array([5.0, 4.0, 3.0, 3.0])) == 0.125
    assert mutation.step(np.array([5.0, 5.0, 5.0])) == 0.015625
    assert mutation.step(np.array([5.0, 5.0, 5.0, 5.0])) == 0.01  # the smallest
    assert mutation.step(np.array([inf, inf, 5.0])) == 0.25  # failures are ignored
    assert mutation.step(np.array([inf, 5.0, 4.0])) == 0.5


def test_adaptive_step_has_exactly_that_length_in_the_unit_cube() -> None:
    unit = Space(("a", "b", "c", "d"), (0,) * 4, (1,) * 4)
    parents = np.full((200, 4), 0.5)
    children = AdaptiveFeasible()(np.random.default_rng(3), parents, unit, progress(2.0, 1.0, 1.0))
    steps = children - parents
    assert np.linalg.norm(steps, axis=1) == pytest.approx(0.125, rel=1e-12)
    # No direction is preferred: the mean of 200 unit vectors in 4-D, 5 sigma per axis.
    assert abs(steps.mean(axis=0) / 0.125).max() < 5 * (1 / 4 / 200) ** 0.5


def test_gaussian_deviation_narrows_to_zero() -> None:
    unit = Space(("a",), (0,), (1,))
    parents = np.full((20_000, 1), 0.5)
    mutation = Gaussian(scale=0.1, shrink=1.0)
    for age, expected in [(0, 0.1), (5, 0.1 * 2 / 3), (15, 0.0)]:
        rng = np.random.default_rng(age)
        children = mutation(rng, parents, unit, progress(*[1.0] * age))
        assert children.std() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("mutation", MUTATIONS.values(), ids=MUTATIONS)
def test_mutation_of_no_parents_returns_no_children(mutation: Mutation) -> None:
    nobody = np.empty((0, 3))
    assert mutation(np.random.default_rng(0), nobody, BOX, progress(1.0)).shape == (0, 3)


def test_rejects_invalid_constants() -> None:
    with pytest.raises(InputError, match="smallest"):
        AdaptiveFeasible(initial=0.9, largest=0.5)
    with pytest.raises(InputError, match="shrink"):
        AdaptiveFeasible(shrink=1.5)
    with pytest.raises(InputError, match="scale"):
        Gaussian(scale=-1)

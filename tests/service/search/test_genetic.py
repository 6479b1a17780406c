"""The genetic search: reproducibility, elites, and the counts of the thesis."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.service.search.genetic_operators import Gaussian, latin_hypercube
from palpate.service.search.genetic_search import GeneticSearch, GeneticSettings
from palpate.service.search.search_interface import FloatArray, Generation, Proposal, Space, Stopped
from palpate.service.search.stop_rules import Stall
from palpate.storage.errors import InputError
from tests.service.search.boxes import contains

BREAST = Space.from_bounds(
    {
        "E_fat_kpa": (5, 20),
        "eta_fat_kpa": (50, 200),
        "E_glandular_kpa": (5, 80),
        "eta_glandular_kpa": (50, 200),
    }
)
Score = Callable[[FloatArray], FloatArray]


def sphere(genes: FloatArray) -> FloatArray:
    return np.asarray(((BREAST.to_unit(genes) - 0.3) ** 2).sum(axis=1))


def fold(search: GeneticSearch, score: Score) -> tuple[list[Generation], str]:
    """Run to the end, scoring only candidates that need an evaluation."""
    history: list[Generation] = []
    while isinstance(proposal := search.propose(history), Proposal):
        scores = score(proposal.genes)
        told = {index: float(scores[index]) for index in proposal.to_evaluate}
        history.append(proposal.complete(told, history))
    return history, proposal.reason


def proposed(search: GeneticSearch, history: Sequence[Generation]) -> Proposal:
    answer = search.propose(history)
    assert isinstance(answer, Proposal)
    return answer


# An arbitrary score: good, identical or failed, chosen by a hash of the genes.
def rough(seed: int) -> Score:
    def score(genes: FloatArray) -> FloatArray:
        key = np.abs(np.sin(genes @ np.arange(1.0, 5.0) * 12.9898 + seed)) * 43758.5453 % 1.0
        return np.where(key < 0.3, np.inf, np.round(10 * key) - 20)

    return score


def test_counts_of_the_thesis_settings() -> None:
    thesis = GeneticSettings()
    assert (thesis.elite, thesis.crossover_children, thesis.mutation_children) == (2, 66, 16)
    assert thesis.parents == 148
    assert thesis.most_evaluations == 84 + 14 * 82 == 1232
    history, reason = fold(GeneticSearch(BREAST, replace(thesis, stall=None), 1), sphere)
    assert reason == "all 15 generations are done"
    assert sum(len(generation.genes) for generation in history) == 1260


@settings(deadline=None, max_examples=60)
@given(
    st.integers(2, 40),
    st.integers(0, 39),
    st.floats(0, 1),
    st.integers(0, 2**32 - 1),
    st.booleans(),
)
def test_any_population_is_filled_within_bounds(
    population: int, elite: int, fraction: float, seed: int, gaussian: bool
) -> None:
    elite = min(elite, population - 1)
    chosen = GeneticSettings(population, 4, elite, fraction)
    if gaussian:
        chosen = replace(chosen, mutation=Gaussian(), initial=latin_hypercube)
    assert chosen.elite + chosen.crossover_children + chosen.mutation_children == population
    history: list[Generation] = []
    search = GeneticSearch(BREAST, chosen, seed)
    while isinstance(proposal := search.propose(history), Proposal):
        assert proposal.genes.shape == (population, 4)
        assert contains(BREAST, proposal.genes)
        bred = bool(history) and bool(np.isfinite(history[-1].scores).any())
        assert population - len(proposal.to_evaluate) == (elite if bred else 0)
        scores = rough(seed)(proposal.genes)
        told = {index: float(scores[index]) for index in proposal.to_evaluate}
        history.append(proposal.complete(told, history))
    assert len(history) == 4


def test_rounding_of_halves_goes_up() -> None:
    # 0.5 * (6 - 1) = 2.5 -> 3, where round() would give 2
    assert GeneticSettings(population=6, elite=1, crossover_fraction=0.5).crossover_children == 3


@pytest.mark.parametrize("score", [sphere, rough(7)], ids=["sphere", "rough"])
def test_same_history_same_proposal_bit_for_bit(score: Score) -> None:
    chosen = GeneticSettings(stall=None, generations=6)
    history, _ = fold(GeneticSearch(BREAST, chosen, 11), score)
    for cut in range(len(history)):
        # A new object, called once and out of order, depends on the history alone.
        resumed = proposed(GeneticSearch(BREAST, chosen, 11), history[:cut])
        assert resumed.genes.tobytes() == history[cut].genes.tobytes()


def test_propose_has_no_side_effects() -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=10), 3)
    history, _ = fold(search, sphere)
    first = proposed(search, history[:2])
    proposed(search, history[:1])
    again = proposed(search, history[:2])
    assert first.genes.tobytes() == again.genes.tobytes()
    assert first.carried == again.carried


def test_seeds_and_generations_draw_different_numbers() -> None:
    chosen = GeneticSettings(population=10)
    zero = proposed(GeneticSearch(BREAST, chosen, 0), [])
    one = proposed(GeneticSearch(BREAST, chosen, 1), [])
    assert not np.isin(zero.genes, one.genes).any()


@settings(deadline=None, max_examples=25)
@given(st.randoms(use_true_random=False), st.integers(0, 2**32 - 1))
def test_the_order_in_which_scores_arrive_does_not_matter(order: Random, seed: int) -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=12, generations=4), seed)
    straight, _ = fold(search, rough(1))
    history: list[Generation] = []
    while isinstance(proposal := search.propose(history), Proposal):
        arrived = list(proposal.to_evaluate)
        order.shuffle(arrived)
        scores = rough(1)(proposal.genes)
        history.append(proposal.complete({i: float(scores[i]) for i in arrived}, history))
    assert [g.genes.tobytes() for g in history] == [g.genes.tobytes() for g in straight]


@pytest.mark.parametrize("score", [sphere, rough(2)], ids=["sphere", "rough"])
def test_elites_keep_their_scores_and_the_best_never_gets_worse(score: Score) -> None:
    chosen = GeneticSettings(population=20, elite=3, generations=10, stall=None)
    search = GeneticSearch(BREAST, chosen, 5)
    history, _ = fold(search, score)
    assert len(history) == 10
    for before, after in itertools.pairwise(history):
        assert after.scores.min() <= before.scores.min()
    for generation in range(1, 10):
        last = history[generation - 1]
        proposal = proposed(search, history[:generation])
        best = sorted(range(20), key=lambda i: (last.scores[i], i))[:3]
        assert list(proposal.carried) == [*best, *[None] * 17]
        assert proposal.genes[:3].tobytes() == last.genes[best].tobytes()
        assert history[generation].scores[:3].tolist() == last.scores[best].tolist()


def test_every_child_descends_from_the_last_generation() -> None:
    chosen = GeneticSettings(population=30, elite=2, crossover_fraction=1.0, stall=None)
    search = GeneticSearch(BREAST, chosen, 8)
    first = Generation(proposed(search, []).genes, np.arange(30.0))
    second = proposed(search, [first])
    for parameter in range(4):  # crossover alone makes no new gene
        assert np.isin(second.genes[:, parameter], first.genes[:, parameter]).all()


def test_good_parents_have_more_children() -> None:
    chosen = GeneticSettings(population=84, crossover_fraction=1.0)
    search = GeneticSearch(BREAST, chosen, 8)
    first = Generation(proposed(search, []).genes, np.arange(84.0))
    children = proposed(search, [first]).genes[2:]
    genes_of = [np.isin(children, first.genes[i]).sum() for i in range(84)]
    # 164 parents: the best is one 9 or 10 times, the last once or twice; half the genes pass.
    assert sum(genes_of[:10]) > 3 * sum(genes_of[-10:])


# --- endings -----------------------------------------------------------------


def test_identical_volumes_end_the_search() -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=3, elite=1), 1)
    genes = proposed(search, []).genes
    stopped = search.propose([Generation(genes, np.array([-1.0, -np.inf, np.inf]))])
    assert isinstance(stopped, Stopped)
    assert stopped.reason.startswith("identical volumes reached")


def test_a_flat_score_stalls_after_the_window() -> None:
    history, reason = fold(
        GeneticSearch(BREAST, GeneticSettings(population=8), 1), lambda g: np.zeros(len(g))
    )
    assert len(history) == 6  # five steps without change
    assert "stalled" in reason


@pytest.mark.parametrize("rule", ["relative", "weighted"])
def test_without_a_stall_rule_the_search_runs_to_its_end(rule: str) -> None:
    flat: Score = lambda g: np.zeros(len(g))  # noqa: E731
    with_rule = GeneticSettings(population=8, stall=Stall(rule=rule))  # type: ignore[arg-type]
    assert len(fold(GeneticSearch(BREAST, with_rule, 1), flat)[0]) == 6
    assert len(fold(GeneticSearch(BREAST, replace(with_rule, stall=None), 1), flat)[0]) == 15


def test_failures_only_are_redrawn_and_then_reported() -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=6), 1)
    history, reason = fold(search, lambda g: np.full(len(g), np.inf))
    assert len(history) == 6
    assert "no simulation has succeeded" in reason
    everyone = np.concatenate([g.genes for g in history])
    assert len(np.unique(everyone, axis=0)) == 36  # no failure is tried twice
    patient = GeneticSearch(BREAST, GeneticSettings(population=6, stall=None), 1)
    assert len(fold(patient, lambda g: np.full(len(g), np.inf))[0]) == 15


def test_failures_rank_last_and_ties_by_index() -> None:
    inf = np.inf
    generation = Generation(np.zeros((6, 1)), np.array([inf, 2.0, inf, 1.0, 2.0, -inf]))
    assert generation.ranking.tolist() == [5, 3, 1, 4, 0, 2]
    assert generation.best == 5


def test_single_success_among_failures_becomes_a_parent() -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=10, elite=1, stall=None), 4)
    first = proposed(search, [])
    scores = np.full(10, np.inf)
    scores[7] = -2.0
    second = proposed(search, [Generation(first.genes, scores)])
    assert second.carried[0] == 7
    assert np.isin(second.genes[1:], first.genes[7]).any()


def test_mutation_step_depends_on_the_whole_history() -> None:
    """Two histories with the same last generation but different pasts give other mutants."""
    chosen = GeneticSettings(population=10, elite=1, crossover_fraction=0.0, stall=None)
    search = GeneticSearch(BREAST, chosen, 4)
    genes = proposed(search, []).genes
    last = Generation(genes, np.arange(10.0))
    better = proposed(search, [Generation(genes, np.arange(10.0) + 1), last])
    stuck = proposed(search, [last, last])
    travelled = [
        np.linalg.norm(BREAST.to_unit(p.genes[1:]) - BREAST.to_unit(stuck.genes[:1]), axis=1)
        for p in (better, stuck)
    ]
    assert not np.allclose(*travelled)


# --- invalid input -------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"population": 1, "elite": 0}, r"search\.population"),
        ({"generations": 0}, r"search\.generations"),
        ({"population": 4, "elite": 4}, r"search\.elite must be from 0 to population - 1 = 3"),
        ({"elite": -1}, r"search\.elite"),
        ({"crossover_fraction": 1.1}, r"search\.crossover_fraction"),
        ({"crossover_fraction": float("nan")}, r"search\.crossover_fraction"),
    ],
)
def test_rejects_invalid_settings(wrong: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        GeneticSettings(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_rejects_a_seed_out_of_range(seed: int) -> None:
    with pytest.raises(InputError, match="seed"):
        GeneticSearch(BREAST, GeneticSettings(), seed)


def test_rejects_the_history_of_another_study() -> None:
    search = GeneticSearch(BREAST, GeneticSettings(population=10), 1)
    foreign = Generation(np.ones((12, 4)), np.zeros(12))
    with pytest.raises(InputError, match="Generation 0 has 12 candidates of 4 parameters"):
        search.propose([foreign])


def test_generation_rejects_nan_and_wrong_shapes() -> None:
    with pytest.raises(InputError, match="Candidate 1 has the score NaN"):
        Generation(np.zeros((2, 3)), np.array([0.0, np.nan]))
    with pytest.raises(InputError, match="shapes"):
        Generation(np.zeros((2, 3)), np.zeros(3))


def test_proposal_needs_scores_of_exactly_its_candidates() -> None:
    proposal = Proposal(np.zeros((3, 1)), (1, None, None))
    history = [Generation(np.zeros((3, 1)), np.array([5.0, 4.0, 6.0]))]
    assert proposal.complete({2: 1.0, 1: 2.0}, history).scores.tolist() == [4.0, 2.0, 1.0]
    with pytest.raises(InputError, match=r"missing: \[2\], not requested: \[0\]"):
        proposal.complete({0: 1.0, 1: 2.0}, history)
    with pytest.raises(InputError, match="carried"):
        Proposal(np.zeros((3, 1)), (None,))


def test_generations_are_immutable() -> None:
    genes = np.zeros((2, 1))
    generation = Generation(genes, np.zeros(2))
    genes[0] = 9.0
    assert generation.genes[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        generation.scores[0] = 1.0

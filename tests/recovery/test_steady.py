"""Searches without generations, which replay their journal whatever the order of endings."""

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import NOT_YET, Dispatcher, Ending
from palpate.service.errors_and_interrupts import GenerationCrashError, Interrupted
from palpate.service.results.results_from_journal import study_results
from palpate.service.search.genetic_search import (
    GeneticSearch,
    GeneticSettings,
    Pool,
    SteadyGenetic,
)
from palpate.service.search.search_interface import Space
from palpate.service.study.search_replay import PendingGeneration, SteadyReplay, replayed
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError, JournalError
from palpate.storage.journal_records import Status
from tests.recovery.stand_ins import SPEC, assert_each_ran_once, run, set_manners, small_spec, told

STEADY = SPEC.replace("  population: 12", "  mode: steady\n  population: 12")
SPACE = Space.from_bounds({"a": (0, 1), "b": (0, 1), "c": (0, 1)})


class Shuffled:
    """A runner of up to 12 concurrent tasks that end in random order, stopping after some."""

    threads = 1

    def __init__(self, seed: int, most: int = 10**9) -> None:
        self._random, self._left = random.Random(seed), most
        self.at_once: list[int] = []

    def call(self, task: Callable[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    def all(self, task: Callable[..., Any], calls: Any) -> Any:
        return [task(*arguments) for _, arguments in calls]

    def run(self, task: Callable[..., Any], calls: Any) -> Iterator[Ending]:
        waiting: list[Any] = []
        source = iter(calls)
        exhausted = False
        while not exhausted or waiting:
            while len(waiting) < 12 and not exhausted:
                call = next(source, None)
                if call is None or call is NOT_YET:
                    exhausted = call is None
                    break
                waiting.append(call)
            if waiting:
                if self._left == 0:
                    raise Interrupted
                self._left -= 1
                self.at_once.append(len(waiting))
                key, arguments = waiting.pop(self._random.randrange(len(waiting)))
                try:
                    yield Ending(key, "returned", task(*arguments))
                except ZeroDivisionError as error:
                    yield Ending(key, "crashed", error=error, reason=str(error), traceback="...")


def log_of(folder: Path) -> StudyLog:
    return StudyLog.read(StudyLayout(folder).journal)


def assert_repeats(folder: Path) -> None:
    """Check that every candidate is proposed again, bit for bit, from the endings before it."""
    log = log_of(folder)
    replay = SteadyReplay(small_spec(STEADY).steady_search)
    genes = {}
    for record in log.endings.values():
        while isinstance(pending := replay.propose(), PendingGeneration):
            genes[pending.first] = pending.genes(pending.first)
        assert genes[record.candidate] == dict(record.genes)  # before its own ending is added
        replay.add(record)


def test_replay_and_interruption_reproduce_the_search(tmp_path: Path) -> None:
    spec = small_spec(STEADY)
    for seed in range(3):
        folder = tmp_path / str(seed) / "study"
        for most in (1, 7, 20, 100):
            try:
                run(folder, Shuffled(seed * 10 + most, most), spec)
            except Interrupted:
                assert_repeats(folder)
        assert sorted(told(folder)) == list(range(60))
        assert_repeats(folder)
        assert_each_ran_once(folder)
        results = study_results(folder)
        assert [g.evaluations for g in results.generations] == [12] * 5
        assert results.stop_reason == "all 5 generations are done"
        first = told(folder)
        run(folder, Shuffled(1), spec)
        assert told(folder) == first


def test_workers_stay_busy_without_a_barrier(tmp_path: Path) -> None:
    dispatcher = Shuffled(1)
    run(tmp_path / "study", dispatcher, small_spec(STEADY))
    assert min(dispatcher.at_once[:40]) >= 10  # equal candidates share one task
    order = list(log_of(tmp_path / "study").endings)
    assert order != sorted(order)


def test_rejects_a_reordered_journal(tmp_path: Path) -> None:
    run(tmp_path / "study", Shuffled(2), small_spec(STEADY))
    endings = list(log_of(tmp_path / "study").endings.items())
    moved = dict(endings[20:30] + endings[:20] + endings[30:])
    with pytest.raises(JournalError, match="but this search proposes"):
        list(replayed(small_spec(STEADY).steady_search, moved))


@pytest.mark.slow
def test_steady_search_on_a_real_cluster(client: Any, tmp_path: Path) -> None:
    set_manners(tmp_path / "store", crash_above=0.019, seconds=0.01)
    conclusion = run(tmp_path / "study", Dispatcher(client), small_spec(STEADY))
    assert sorted(told(tmp_path / "study")) == list(range(60))
    assert_repeats(tmp_path / "study")
    assert conclusion.best is not None
    assert {r.status for r in log_of(tmp_path / "study").endings.values()} >= {
        Status.DONE,
        Status.CRASHED,
    }


def test_crashes_only_stop_the_search(tmp_path: Path) -> None:
    set_manners(tmp_path / "store", crash_above=0.0)
    with pytest.raises(GenerationCrashError, match="All 12 candidates"):
        run(tmp_path / "study", Shuffled(3), small_spec(STEADY))
    assert told(tmp_path / "study") == {}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with open_cluster(workers=2, allowed_failures=0) as cluster:
        yield cluster.client


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("mode: steady\n  strategy: cma", "mode: steady needs strategy: genetic, got cma"),
        ("in_flight: 4", "in_flight needs mode: steady"),
    ],
)
def test_rejects_inconsistent_keys(more: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        small_spec(SPEC.replace("population: 12", more))


def test_older_studies_keep_their_digests() -> None:
    known = small_spec(SPEC).as_dict()["search"]
    assert not {"mode", "in_flight"} & set(known)
    assert small_spec(STEADY).as_dict()["search"]["mode"] == "steady"


def distance(genes: Any) -> float:
    return float(np.log(1e-12 + np.sum((np.asarray(genes) - [0.3, 0.6, 0.45]) ** 2)))


def steady_best(seed: int, settings: GeneticSettings, in_flight: int) -> float:
    """Run a steady search with tasks of random durations and return its best score."""
    search, pool = SteadyGenetic(SPACE, settings, seed, in_flight), Pool(settings.population)
    drawn = random.Random(seed)
    under_way: list[tuple[float, int, Any]] = []
    now, candidate, best = 0.0, 0, np.inf
    ended: list[tuple[Any, float]] = []
    total = settings.population * settings.generations
    while len(ended) < total:
        while candidate < total and search.known_at(candidate) <= len(ended):
            for genes, score in ended[pool.count : search.known_at(candidate)]:
                pool.add(genes, score)
            genes = search.propose(candidate, pool)
            under_way.append((now + drawn.uniform(0.5, 2.0), candidate, genes))
            candidate += 1
        under_way.sort(key=lambda one: one[0])
        now, _, genes = under_way.pop(0)
        ended.append((genes.tolist(), distance(genes)))
        best = min(best, ended[-1][1])
    return float(best)


def barrier_best(seed: int, settings: GeneticSettings) -> float:
    search, history = GeneticSearch(SPACE, settings, seed), []  # type: ignore[var-annotated]
    for _ in range(settings.generations):
        proposal = search.propose(history)
        scores = {i: distance(proposal.genes[i]) for i in proposal.to_evaluate}  # type: ignore[union-attr]
        history.append(proposal.complete(scores, history))  # type: ignore[union-attr]
    return float(min(g.scores.min() for g in history))


def test_steady_search_is_as_efficient_as_generations() -> None:
    settings = GeneticSettings(population=40, generations=12, stall=None)
    seeds = range(15)
    barrier = np.median([barrier_best(seed, settings) for seed in seeds])
    steady = np.median([steady_best(seed, settings, 40) for seed in seeds])
    drawn = [np.random.default_rng(seed).random((480, 3)) for seed in seeds]
    chance = np.median([min(map(distance, points)) for points in drawn])
    assert steady < chance - 2
    assert steady < barrier + 1

"""Strategies interrupted at any point continue with the same candidates and scores."""

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.task_dispatch import Ending
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import StudyLayout
from tests.recovery.stand_ins import (
    SPEC,
    Inline,
    assert_each_ran_once,
    executions,
    run,
    small_spec,
    told,
)

LEVELS = "  levels: [{nodes: 500, spacing_mm: 2}]\n"
STRATEGIES = {
    "least-squares": "  strategy: least-squares\n" + LEVELS,
    "genetic+least-squares": "  strategy: genetic+least-squares\n  starts: 2\n",
    "cma": "  strategy: cma\n",
}


def spec_of(strategy: str) -> StudySpec:
    return small_spec(SPEC.replace("  population", STRATEGIES[strategy] + "  population"))


class Cut(Inline):
    """A runner that stops after some endings; the rest of a generation arrives in reverse."""

    def __init__(self, endings: int) -> None:
        self.left = endings

    def run(
        self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        for key, arguments in list(calls)[::-1]:
            if self.left == 0:
                raise Interrupted("cut")
            self.left -= 1
            yield Ending(key, "returned", task(*arguments))


def journal(folder: Path) -> StudyLog:
    return StudyLog.read(StudyLayout(folder).journal)


@pytest.mark.parametrize("strategy", list(STRATEGIES))
def test_interrupted_search_matches_an_undisturbed_one(tmp_path: Path, strategy: str) -> None:
    calm, cut = tmp_path / "calm" / "demo", tmp_path / "cut" / "demo"
    spec = spec_of(strategy)
    run(calm, Inline(), spec)
    reference = told(calm)
    for endings in (1, 2, 3, 5, 7, 11, 13):
        try:
            run(cut, Cut(endings), spec)
        except Interrupted:
            assert told(cut).items() <= reference.items()
    run(cut, Inline(), spec)
    assert told(cut) == reference
    fits = [[r.fit for _, r in sorted(journal(f).endings.items())] for f in (calm, cut)]
    assert json.dumps(fits[0]) == json.dumps(fits[1])
    assert journal(cut).identification == journal(calm).identification
    assert_each_ran_once(cut)


def test_genetic_stage_matches_a_genetic_search(tmp_path: Path) -> None:
    alone, polished = tmp_path / "a" / "demo", tmp_path / "b" / "demo"
    run(alone, Inline())
    run(polished, Inline(), spec_of("genetic+least-squares"))
    both = told(polished)
    assert told(alone).items() <= both.items()
    assert len(both) > len(told(alone))


def test_least_squares_finds_the_optimum_and_its_interval(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    conclusion = run(folder, Inline(), spec_of("least-squares"))
    assert conclusion.best is not None
    assert conclusion.best.level is None
    assert conclusion.best.genes["E_fat_kpa"] == pytest.approx(10, rel=1e-4)
    assert len(executions(folder)) < 25
    found = study_results(folder).identification
    assert found is not None
    # Twenty residuals of 1 % each: 0.01 / sqrt(20), times 1.645 for 90 %.
    interval = found.constants["E_fat"].interval
    assert interval is not None
    assert interval.upper / interval.lower - 1 == pytest.approx(2 * 1.645e-2 / 20**0.5, rel=0.01)
    assert interval.lower < 10 < interval.upper
    levels = {r.generation: r.level for r in journal(folder).endings.values()}
    assert [levels[g] for g in sorted(levels)] == sorted(
        levels.values(), key=lambda level: level is None
    )


def test_results_include_the_estimate_before_polish(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline(), spec_of("genetic+least-squares"))
    results = study_results(folder)
    estimate = results.estimates["E_fat"]
    assert estimate.before_polish is not None
    assert estimate.estimate == pytest.approx(10, rel=1e-4)
    assert abs(estimate.before_polish / 10 - 1) > 1e-3
    assert study_json(results)["estimates"]["E_fat"]["before_polish"] == estimate.before_polish


def test_identification_is_not_recomputed(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline())
    before, ran = journal(folder).identification, executions(folder)
    assert before is not None and before.fit is not None
    run(folder, Inline())
    assert executions(folder) == ran
    assert journal(folder).identification == before

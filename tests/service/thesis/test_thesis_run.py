"""Runs of the experiments: only missing parts are computed, and their time is estimated."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from palpate.service.cli import main
from palpate.service.cluster.task_dispatch import Ending
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.thesis import remaining_time as estimating
from palpate.service.thesis import thesis_experiments as running
from palpate.service.thesis.remaining_time import estimate, shipped_seconds
from palpate.service.thesis.thesis_experiments import (
    EXPERIMENTS,
    GENETIC,
    Phase,
    Step,
    ThesisRequest,
    compressions,
    phases_of,
    run_thesis,
    search_runs,
    study_of_run,
)
from palpate.storage.errors import InputError
from palpate.workers.tasks.thesis_tasks import Bend, Request, Spent, Timed
from palpate.workers.thesis.phantom_compression import BOUNDS, TARGETS, runs_at


@dataclass(frozen=True)
class Stub(Request):
    """A part without cost."""

    MODULE: ClassVar[str] = "palpate.workers.tasks.thesis_tasks"

    number: int


def work(request: Stub) -> Spent:
    """Store the part's cost."""
    request.part.save(Timed(Spent(9.0, 3.0, "here")), {})
    return request.spent


class InProcess:
    """A dispatcher that stops after some tasks."""

    threads = 1

    def __init__(self, stop_after: int = 10**9) -> None:
        self.left, self.ran = stop_after, 0

    def run(self, task: Any, calls: Any) -> Iterator[Ending]:
        for key, arguments in calls:
            if self.ran == self.left:
                raise Interrupted
            self.ran += 1
            yield Ending(key, "returned", task(*arguments))


@pytest.fixture
def request_of_stubs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ThesisRequest:
    store = str(tmp_path / "store")

    def stubs(experiment: str, store: str, scale: Any) -> list[Phase]:
        return [Phase("working", work, [Stub(store, scale, n) for n in range(5)])]

    monkeypatch.setattr(running, "phases_of", stubs)
    monkeypatch.setattr(estimating, "phases_of", stubs)
    return ThesisRequest(("coefficients",), "sketch", Path(store), tmp_path, GENETIC)


def test_finished_parts_are_not_run_again(request_of_stubs: ThesisRequest) -> None:
    steps: list[Step] = []
    first, second, third = InProcess(stop_after=2), InProcess(), InProcess()
    with pytest.raises(Interrupted):
        run_thesis(request_of_stubs, first, steps.append)  # type: ignore[arg-type]
    run_thesis(request_of_stubs, second, steps.append)  # type: ignore[arg-type]
    run_thesis(request_of_stubs, third, steps.append)  # type: ignore[arg-type]
    assert (first.ran, second.ran, third.ran) == (2, 3, 0)
    assert [step.done for step in steps] == [0, 1, 2, 2, 3, 4, 5, 5]
    assert all(step.of == 5 for step in steps)


def test_estimate_follows_the_cost_of_finished_parts(request_of_stubs: ThesisRequest) -> None:
    before = estimate(request_of_stubs, workers=2)
    assert (before.missing, before.unknown) == (5, 5)
    assert "none of them has been timed" in before.sentence
    with pytest.raises(Interrupted):
        run_thesis(request_of_stubs, InProcess(stop_after=1), lambda _: None)  # type: ignore[arg-type]
    now = estimate(request_of_stubs, workers=2)
    assert (now.missing, now.unknown, now.cpu_s) == (4, 0, 12.0)
    assert now.machines == ("this machine",)
    assert "about 6 s on 2 free cores" in now.sentence
    run_thesis(request_of_stubs, InProcess(), lambda _: None)  # type: ignore[arg-type]
    assert "nothing to compute" in estimate(request_of_stubs, workers=2).sentence


def test_untimed_search_is_estimated_from_its_simulations(tmp_path: Path) -> None:
    request = ThesisRequest(("search",), "reduced", tmp_path / "store", tmp_path, "cma")
    shipped = shipped_seconds("reduced")
    assert shipped is not None
    one = {"X1": "vary, X1", "X2": "vary, X1", "X3": "vary, X3"}
    each = [run.most_evaluations * shipped.seconds[one[run.target]] for run in request.searches]
    found = estimate(request, workers=2)
    assert (found.missing, found.unknown) == (15, 0)
    assert found.cpu_s == pytest.approx(sum(each))


def test_experiments_share_equal_parts(tmp_path: Path) -> None:
    store = str(tmp_path)
    pressed = {p.part.name for p in compressions(store, "reduced")}
    assert len(pressed) == 10 * 2 * 2 * 2
    again = phases_of("mammogram", store, "reduced")[0].requests
    assert {r.part.name for r in again} < pressed
    for experiment in EXPERIMENTS:
        labels = [r.label for p in phases_of(experiment, store, "reduced") for r in p.requests]
        assert len(labels) == len(set(labels))


def test_searches_match_the_thesis(tmp_path: Path) -> None:
    runs = search_runs(tmp_path, "full", GENETIC)
    assert [(r.target, r.phantom) for r in runs] == runs_at("full")
    assert len(runs) == 15
    for run in runs:
        spec = run.spec
        assert (spec.search.population, spec.search.generations, spec.search.elite) == (84, 15, 2)
        assert run.most_evaluations == 1232
        assert spec.search.parameters == {n: BOUNDS[n] for n in TARGETS[run.target]}
        assert spec.target.constants == TARGETS[run.target]
        assert ("E_skin_kpa" in spec.search.parameters) == (run.target == "X3")
        assert not run.is_finished
    assert len({run.folder for run in runs}) == 15


def test_rejects_unknown_experiments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["thesis", "tables"]) == 2
    assert "coefficients, mesh-quality" in capsys.readouterr().err
    assert main(["thesis", "all", "--full", "--sketch"]) == 2
    with pytest.raises(InputError):
        study_of_run("X1", 1, "sketch", "simplex")


def test_dry_run_computes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--store", str(tmp_path / "store"), "--out", str(tmp_path / "out")]
    assert main(["thesis", "sensitivity", "--sketch", "--dry-run", *arguments]) == 0
    assert "parts are missing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_killed_experiment_continues_where_it_stopped(tmp_path: Path) -> None:
    store = tmp_path / "store"
    command = [
        sys.executable, "-m", "palpate", "thesis", "coefficients", "--sketch", "--workers", "1",
        "--store", str(store), "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    gold = Bend(str(store), "sketch", 0).part
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as killed:
        while not gold.is_finished:
            assert killed.poll() is None
            time.sleep(0.1)
        killed.send_signal(signal.SIGKILL)
    made = gold.path.stat().st_mtime_ns
    subprocess.run(command, check=True, capture_output=True)
    assert gold.path.stat().st_mtime_ns == made
    assert (tmp_path / "out" / "coefficients-sketch.html").is_file()
    assert (tmp_path / "out" / "coefficients-sketch.json").is_file()

"""Studies give the same candidates and scores under every disturbance.

The reference is a run without a cluster, one candidate after the other.
"""

import gc
import json
import logging
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher, Ending
from palpate.service.errors_and_interrupts import ClusterError, GenerationCrashError, Interrupted
from palpate.service.study import study_folder
from palpate.service.study.loop import Study
from palpate.service.study.study_events import Observer
from palpate.service.study.study_folder import StudyLog
from palpate.storage import journal as storage_journal
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError, JournalError, NewerSchemaError, StoreError
from palpate.storage.journal_records import EvaluationRecord, Status
from tests.recovery.stand_ins import (
    KEPT,
    SPEC,
    TASKS,
    Inline,
    assert_each_ran_once,
    executions,
    rewrite,
    run,
    set_manners,
    small_spec,
    told,
)


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with open_cluster(workers=2, allowed_failures=0) as cluster:
        yield cluster.client


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Any, ...]]:
    folder = tmp_path_factory.mktemp("reference") / "demo"
    run(folder, Inline())
    return told(folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "runs" / "demo"


def journal_of(folder: Path) -> Path:
    return StudyLayout(folder).journal


def test_evaluates_all_candidates_except_elites(reference: dict[int, tuple[Any, ...]]) -> None:
    assert len(reference) == 12 + 4 * 10
    elites = {12 * g + i for g in range(1, 5) for i in range(2)}
    assert not elites & set(reference)
    assert {ending[3] for ending in reference.values()} == {Status.DONE, Status.DIVERGED}


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_result_is_independent_of_the_number_of_workers(
    client: Any, folder: Path, reference: dict[int, tuple[Any, ...]], workers: int
) -> None:
    client.cluster.scale(workers)
    client.wait_for_workers(workers, timeout=60)
    while len(client.nthreads()) != workers:
        time.sleep(0.02)
    run(folder, Dispatcher(client))
    client.cluster.scale(2)
    assert told(folder) == reference
    assert_each_ran_once(folder)


@pytest.mark.parametrize("asked", [1, 9, 30])
def test_interruption_does_not_change_the_result(
    client: Any, folder: Path, reference: dict[int, tuple[Any, ...]], asked: int
) -> None:
    class Count(Observer):
        ended = 0

        def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
            Count.ended += 1

    with pytest.raises(Interrupted):
        run(folder, Dispatcher(client, stop=lambda: Count.ended >= asked), observers=[Count()])
    before = told(folder)
    assert asked <= len(before) < len(reference)
    run(folder, Dispatcher(client))
    assert told(folder) == reference
    assert_each_ran_once(folder)


def test_finished_study_computes_nothing(folder: Path) -> None:
    first = run(folder, Inline())
    ran = executions(folder)
    second = run(folder, Inline())
    assert executions(folder) == ran
    assert second.best == first.best


def test_another_study_reuses_the_store(folder: Path) -> None:
    run(folder, Inline())
    ran = executions(folder)
    other = folder.with_name("other")
    run(other, Inline())
    assert executions(other) == ran
    assert told(other) == told(folder)
    endings = StudyLog.read(journal_of(other)).endings.values()
    assert all(record.reused for record in endings)


@pytest.mark.parametrize("keep", ["best", "elites", "all"])
def test_keeps_the_requested_volumes(folder: Path, keep: str) -> None:
    conclusion = run(folder, Inline(), small_spec(SPEC + f"keep: {keep}\n"))
    kept = set((folder.parent / "store" / KEPT).read_text().split())
    endings = StudyLog.read(journal_of(folder)).endings
    done = [r for _, r in sorted(endings.items()) if r.status is Status.DONE]
    assert conclusion.best is not None
    if keep == "best":
        wanted = {conclusion.best.digest}
    elif keep == "all":
        wanted = {r.digest for r in done}
    else:
        best_two = [
            sorted((r for r in done if r.generation <= g), key=lambda r: r.score["gsf"])[:2]  # type: ignore[index]
            for g in range(5)
        ]
        wanted = {r.digest for pair in best_two for r in pair}
    assert kept == wanted


def test_crash_is_recorded_with_its_traceback(client: Any, folder: Path) -> None:
    set_manners(folder.parent / "store", crash_above=0.017)
    conclusion = run(folder, Dispatcher(client))
    endings = StudyLog.read(journal_of(folder)).endings.values()
    crashed = [r for r in endings if r.status is Status.CRASHED]
    assert crashed
    assert all(r.genes["E_fat_kpa"] > 17 for r in crashed)
    assert all(r.genes["E_fat_kpa"] <= 17 for r in endings if r.status is Status.DONE)
    for record in crashed:
        assert record.reason.startswith("ZeroDivisionError: no such tissue: E_fat = 0.01")
        assert "in misbehave" in record.traceback
        assert "distributed" not in record.traceback
    assert conclusion.best is not None
    assert conclusion.best.status is Status.DONE


class Crashing(Inline):
    """A runner that reports exceptions like a worker."""

    def run(self, task: Any, calls: Any) -> Iterator[Ending]:
        for key, arguments in calls:
            try:
                yield Ending(key, "returned", task(*arguments))
            except ZeroDivisionError as error:
                reason = f"ZeroDivisionError: {error}"
                yield Ending(key, "crashed", None, error, reason, "in misbehave")


def test_generation_of_identical_crashes_stops_the_study(
    folder: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    set_manners(folder.parent / "store", crash_above=0.0)
    with pytest.raises(GenerationCrashError, match="no such tissue") as stopped:
        run(folder, Crashing())
    assert "All 12 candidates of generation 1" in str(stopped.value)
    assert stopped.value.traceback == "in misbehave"
    assert told(folder) == {}
    set_manners(folder.parent / "store")  # corrected
    run(folder, Crashing())
    assert told(folder) == reference


def test_later_crashes_keep_earlier_generations(
    folder: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    def stop_later(request: Any) -> Any:
        finished = len(executions(folder))
        set_manners(folder.parent / "store", crash_above=0.0 if finished >= 12 else 1.0)
        return TASKS.evaluate(request)

    tasks = replace(TASKS, evaluate=stop_later)
    with pytest.raises(GenerationCrashError, match="generation 2 "):
        Study(small_spec(), folder, tasks=tasks).run(Crashing())  # type: ignore[arg-type]
    assert set(range(12)) <= set(told(folder))
    assert all(ending[3] is not Status.CRASHED for ending in told(folder).values())
    set_manners(folder.parent / "store")
    run(folder, Crashing())
    assert told(folder) == reference


def test_different_crashes_are_recorded(folder: Path) -> None:
    def crash(request: Any) -> Any:
        soft = request["constants"]["E_fat"] < 0.01
        raise ZeroDivisionError("soft" if soft else "stiff")

    spec = small_spec(SPEC.replace("generations: 5", "generations: 1"))
    tasks = replace(TASKS, evaluate=crash)
    conclusion = Study(spec, folder, tasks=tasks).run(Crashing())  # type: ignore[arg-type]
    assert conclusion.best is None
    endings = StudyLog.read(journal_of(folder)).endings.values()
    assert [record.status for record in endings] == [Status.CRASHED] * 12


def test_candidate_that_kills_its_workers_is_lost(client: Any, folder: Path) -> None:
    # Exactly one of the first twelve candidates is above this bound.
    spec = small_spec(SPEC.replace("generations: 5", "generations: 1"))
    run(folder.parent.parent / "look" / "demo", Inline(), spec)
    first = told(folder.parent.parent / "look" / "demo").values()
    highest, second = sorted((e[0]["E_fat_kpa"] / 1000 for e in first), reverse=True)[:2]
    set_manners(folder.parent / "store", die_above=(highest + second) / 2)
    run(folder, Dispatcher(client, max_attempts=2), spec)
    lost = [r for r in StudyLog.read(journal_of(folder)).endings.values() if r.status == "lost"]
    assert [record.attempts for record in lost] == [2]
    assert "worker died" in lost[0].reason
    assert len(told(folder)) == 12


def test_dying_cluster_does_not_fail_candidates(
    client: Any, folder: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    set_manners(folder.parent / "store", die_above=0.012)
    with pytest.raises(ClusterError, match="too little memory"):
        run(folder, Dispatcher(client, max_attempts=1))
    assert all(ending[3] != Status.LOST for ending in told(folder).values())
    set_manners(folder.parent / "store")
    run(folder, Dispatcher(client))
    assert told(folder) == reference


def test_full_disk_of_a_worker_does_not_fail_candidates(
    client: Any, folder: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    set_manners(folder.parent / "store", full_disk_above=0.012)
    with pytest.raises(StoreError, match="disk of this worker is full"):
        run(folder, Dispatcher(client))
    set_manners(folder.parent / "store")
    run(folder, Dispatcher(client))
    assert told(folder) == reference


def test_full_disk_keeps_the_written_journal(
    folder: Path, reference: dict[int, tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = storage_journal._write_all
    calls = 0

    def fills_up(handle: int, data: bytes) -> None:
        nonlocal calls
        calls += 1
        if calls > 20:
            written(handle, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        written(handle, data)

    monkeypatch.setattr(storage_journal, "_write_all", fills_up)
    with pytest.raises(JournalError, match="disk is full"):
        run(folder, Inline())
    monkeypatch.undo()
    assert 0 < len(told(folder)) < len(reference)
    run(folder, Inline())
    assert told(folder) == reference


def test_rejects_a_second_driver(folder: Path) -> None:
    study = Study(small_spec(), folder, tasks=TASKS)
    with study.folder.open(), pytest.raises(JournalError, match="already running"):
        run(folder, Inline())


def test_torn_last_line_is_ignored(folder: Path, reference: dict[int, tuple[Any, ...]]) -> None:
    run(folder, Inline())
    data = journal_of(folder).read_bytes()
    journal_of(folder).write_bytes(data[: 3 * len(data) // 5])
    run(folder, Inline())
    assert told(folder) == reference


def test_rejects_a_damaged_line_by_number(folder: Path) -> None:
    run(folder, Inline())
    lines = journal_of(folder).read_bytes().splitlines(keepends=True)
    lines[6] = b'{"kind": "evaluation", \x00\x00\n'
    journal_of(folder).write_bytes(b"".join(lines))
    with pytest.raises(JournalError, match="line 7"):
        run(folder, Inline())


def test_rejects_genes_of_another_search(folder: Path) -> None:
    run(folder, Inline())
    lines = [json.loads(line) for line in journal_of(folder).read_text().splitlines()]
    tampered = next(line for line in lines if line.get("candidate") == 5)
    tampered["genes"]["E_fat_kpa"] += 1e-9
    rewrite(journal_of(folder), lines)
    with pytest.raises(JournalError, match="Candidate 5"):
        run(folder, Inline())


def test_rejects_newer_stores_and_journals(folder: Path) -> None:
    run(folder, Inline())
    marker = folder.parent / "store" / "palpate-store.json"
    marker.write_text(marker.read_text().replace('"schema_version":1', '"schema_version":2'))
    with pytest.raises(NewerSchemaError, match="newer version"):
        run(folder, Inline())
    journal = journal_of(folder)
    journal.write_text(journal.read_text().replace('"schema_version":2', '"schema_version":3'))
    with pytest.raises(NewerSchemaError, match="newer version"):
        run(folder, Inline())


def test_rejects_a_changed_study_listing_its_keys(folder: Path) -> None:
    run(folder, Inline())
    changed = small_spec(SPEC.replace("population: 12", "population: 14"))
    with pytest.raises(InputError, match=r"search\.population: 12 before, 14 now"):
        run(folder, Inline(), changed)


def test_rejects_changed_code_unless_accepted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(folder, Inline())
    other = study_folder.versions() | {"code": "another"}
    monkeypatch.setattr(study_folder, "versions", lambda: other)
    with pytest.raises(InputError, match="--accept-new-code"):
        run(folder, Inline())
    run(folder, Inline(), accept_new_code=True)


def test_rejects_a_changed_image(folder: Path) -> None:
    run(folder, Inline())
    changed = replace(TASKS, target=lambda *_: {"target": "another", "kind": "image"})
    with pytest.raises(InputError, match="target of this study was"):
        Study(small_spec(), folder, tasks=changed).run(Inline())  # type: ignore[arg-type]


def test_failing_observer_is_dropped(
    folder: Path, reference: dict[int, tuple[Any, ...]], caplog: pytest.LogCaptureFixture
) -> None:
    class Broken(Observer):
        def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
            raise RuntimeError("the screen is gone")

    with caplog.at_level(logging.ERROR):
        run(folder, Inline(), observers=[Broken()])
    assert told(folder) == reference
    assert len(caplog.records) == 1


def test_waiting_for_workers_times_out(client: Any, folder: Path) -> None:
    client.cluster.scale(0)
    while client.nthreads():
        time.sleep(0.02)
    try:
        with pytest.raises(ClusterError, match="no worker at"):
            run(folder, Dispatcher(client, no_worker_s=1.0))
    finally:
        client.cluster.scale(2)


@pytest.mark.slow
def test_long_study_keeps_few_endings_in_memory(folder: Path) -> None:
    held = []

    class Hold(Observer):
        def generation_ended(self, number: int, generation: Any) -> None:
            gc.collect()
            held.append(sum(isinstance(o, EvaluationRecord) for o in gc.get_objects()))

    long = SPEC.replace("generations: 5", "generations: 12\n  stall: null")
    before = sum(isinstance(o, EvaluationRecord) for o in gc.get_objects())
    conclusion = run(folder, Inline(), small_spec(long), observers=[Hold()])
    assert len(held) == 12
    assert max(held) - before <= 2 * 12 + 1  # this generation, the one before it, and the best
    scores = {c: e[4]["gsf"] for c, e in told(folder).items() if e[4]}
    assert conclusion.best is not None
    assert conclusion.best.candidate == min(scores, key=lambda c: (scores[c], c))

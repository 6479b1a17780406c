"""The queue as a fold over its journal, and the states of jobs."""

from pathlib import Path

import pytest

from palpate.service.server.jobs.job_queue import Action, Queue, StateError
from palpate.storage.errors import JournalError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "queue.jsonl"


def test_queue_survives_restart(path: Path) -> None:
    queue = Queue(path)
    first, _ = queue.submit("study", "demo", "ann", {"spec": {}}, priority=2)
    second, _ = queue.submit("study", "demo", "ann", {"spec": {}})
    store, _ = queue.submit("study", "store", "bob", {"spec": {}})
    assert [first.id, second.id, store.id] == ["demo", "demo-2", "store-2"]
    queue.change("demo", "pause")
    queue.change("demo-2", "fail", "no disk")
    queue.prioritise("demo", -4)
    before = queue.jobs
    queue.close()
    again = Queue(path)
    assert again.jobs == before
    assert [job.state for job in again.jobs] == ["paused", "failed", "waiting"]
    assert again.jobs[0].priority == -4
    again.close()


def test_ignores_torn_last_line(path: Path) -> None:
    queue = Queue(path)
    queue.submit("study", "demo", "ann", {})
    queue.change("demo", "pause")
    queue.close()
    path.write_bytes(path.read_bytes()[:-7])
    again = Queue(path)
    assert again.jobs[0].state == "waiting"
    again.change("demo", "cancel")
    again.close()
    assert Queue(path).jobs[0].state == "cancelled"


def test_repeated_key_returns_same_job(path: Path) -> None:
    queue = Queue(path)
    first, new = queue.submit("study", "demo", "ann", {}, key="k")
    assert new
    assert queue.submit("study", "demo", "ann", {}, key="k") == (first, False)
    assert queue.submit("study", "demo", "bob", {}, key="k")[1]
    assert queue.submit("study", "demo", "ann", {})[1]


@pytest.mark.parametrize(
    ("actions", "state"),
    [
        (["pause", "pause", "resume", "resume"], "waiting"),
        (["fail", "resume", "finish"], "finished"),
        (["pause", "cancel", "cancel"], "cancelled"),
    ],
)
def test_actions_lead_to_the_expected_state(path: Path, actions: list[Action], state: str) -> None:
    queue = Queue(path)
    queue.submit("study", "demo", "ann", {})
    for action in actions:
        queue.change("demo", action)
    assert queue.jobs[0].state == state


@pytest.mark.parametrize(
    "actions", [["finish", "pause"], ["cancel", "resume"], ["finish", "cancel"], ["pause", "fail"]]
)
def test_rejects_invalid_state_changes(path: Path, actions: list[Action]) -> None:
    queue = Queue(path)
    queue.submit("study", "demo", "ann", {})
    queue.change("demo", actions[0])
    with pytest.raises(StateError, match="demo is"):
        queue.change("demo", actions[1])


def test_a_second_service_is_refused(path: Path) -> None:
    queue = Queue(path)
    with pytest.raises(JournalError, match="Another `palpate serve`"):
        Queue(path)
    queue.close()


def test_error_names_invalid_record(path: Path) -> None:
    path.write_text('{"kind":"changed","job":"nix","to":"paused","reason":"","at":""}\n')
    with pytest.raises(JournalError, match="was edited"):
        Queue(path)

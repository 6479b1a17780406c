"""Studies that are ended by a rule or an observer, and can be continued."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from palpate.service.study.loop import Study
from palpate.service.study.study_events import Observer, StopSearch
from palpate.storage.journal_records import EvaluationRecord
from tests.recovery.stand_ins import SPEC, TASKS, Inline, run, small_spec, told

STEADY = SPEC.replace("generations: 5", "generations: 5\n  mode: steady\n  in_flight: 3")


def ended(folder: Path, keys: str, spec: str = SPEC, *observers: Observer) -> str:
    text = spec.replace("generations: 5", f"generations: 5\n  {keys}" if keys else "generations: 5")
    study = Study(small_spec(text), folder, tasks=TASKS, observers=observers)
    return study.run(Inline()).reason  # type: ignore[arg-type]


def test_a_score_ends_a_search(tmp_path: Path) -> None:
    assert ended(tmp_path / "calm", "") == "all 5 generations are done"
    reason = ended(tmp_path / "good", "stop: {score: -1}")
    assert reason == "GSF -1 is reached"
    scores = [score["gsf"] for *_, score, _ in told(tmp_path / "good").values() if score]
    assert min(scores) <= -1
    assert len(told(tmp_path / "good")) < len(told(tmp_path / "calm"))


def test_stop_score_uses_the_objective(tmp_path: Path) -> None:
    keys = "stop: {score: 0.5}\nscore: {objective: jc}"
    assert ended(tmp_path / "demo", keys) == "Jaccard coefficient 0.5 is reached"


def test_the_limit_of_evaluations_is_not_exceeded(tmp_path: Path) -> None:
    reason = ended(tmp_path / "demo", "stop: {evaluations: 31}")
    assert reason == "the next generation would exceed 31 evaluations"
    assert len(told(tmp_path / "demo")) == 12 + 10


@pytest.mark.parametrize("spec", [SPEC, STEADY], ids=["generations", "steady"])
def test_time_ends_a_search(tmp_path: Path, spec: str) -> None:
    reason = ended(tmp_path / "demo", "stop: {hours: 1.0e-9}", spec)
    assert reason == "the time limit search.stop.hours (1e-09 h) has been reached"
    assert len(told(tmp_path / "demo")) < 12


class EnoughIsEnough(Observer):
    def __init__(self, after: int) -> None:
        self.left = after

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        self.left -= 1
        if self.left == 0:
            raise StopSearch("somebody has seen enough")


@pytest.mark.parametrize(
    ("spec", "evaluated"), [(SPEC, 12 + 10), (STEADY, 15)], ids=["generations", "steady"]
)
def test_an_observer_ends_a_search(tmp_path: Path, spec: str, evaluated: int) -> None:
    folder = tmp_path / "demo"
    assert ended(folder, "", spec, EnoughIsEnough(15)) == "somebody has seen enough"
    assert abs(len(told(folder)) - evaluated) <= (2 if spec is STEADY else 0)
    study = Study(small_spec(spec), folder, tasks=TASKS)
    assert study.ended


@pytest.mark.parametrize(
    "keys",
    [
        "start: [{E_fat_kpa: 8, E_glandular_kpa: 30}]",
        "scale: {E_fat_kpa: log}\n  constraints: [E_glandular_kpa > 1.5 E_fat_kpa]",
        "stop: {evaluations: 40}",
    ],
)
def test_interrupted_studies_stop_at_the_same_candidate(tmp_path: Path, keys: str) -> None:
    class Stopping(Inline):
        def run(self, task: Any, calls: Any) -> Any:
            for count, ending in enumerate(super().run(task, calls)):
                if count == 5:
                    raise KeyboardInterrupt
                yield ending

    text = SPEC.replace("generations: 5", f"generations: 5\n  {keys}")
    spec = small_spec(text)
    run(tmp_path / "calm" / "demo", Inline(), spec)
    for _ in range(2):
        with suppress(KeyboardInterrupt):
            run(tmp_path / "again" / "demo", Stopping(), spec)
        assert 0 < len(told(tmp_path / "again" / "demo")) < len(told(tmp_path / "calm" / "demo"))
    run(tmp_path / "again" / "demo", Inline(), spec)
    assert told(tmp_path / "again" / "demo") == told(tmp_path / "calm" / "demo")

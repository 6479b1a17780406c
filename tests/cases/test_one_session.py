"""Checks, log, page and Ctrl-C of a study, for all interfaces."""

import os
import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
import typer

import palpate
import palpate.diagnosis
import palpate.study
from palpate.service.cli import main
from palpate.service.commands.command_line import INTERRUPTED, interruptible
from palpate.service.errors_and_interrupts import GenerationCrashError, Interrupted, stop_requests
from palpate.service.run_study import Entrance, run_study
from palpate.service.server.jobs.study_and_diagnosis_jobs import run_queued_study, study_request
from palpate.service.study import study_session as session_module
from palpate.service.study.loop import Study
from palpate.service.study.study_session import Session, session
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import SPEC, TASKS, Inline, small_spec, told

IN_PASCAL = SPEC.replace("E_fat_kpa: [5, 20]", "E_fat_kpa: [5000, 20000]")


class Stopped(Inline):
    """Dispatcher that requests a stop after a number of endings."""

    def __init__(self, after: int) -> None:
        self.left = after

    def run(self, task: Any, calls: Any) -> Iterator[Any]:
        for ending in super().run(task, calls):
            if self.left == 0:
                raise Interrupted
            self.left -= 1
            yield ending


class Crashing(Inline):
    def call(self, task: Any, *arguments: Any) -> Any:
        if task is TASKS.target:
            raise GenerationCrashError("All 12 candidates have crashed.", "Traceback of a worker")
        return super().call(task, *arguments)


def at_hand(dispatcher: Any) -> Any:
    return nullcontext(Session(dispatcher))


def study(folder: Path, text: str = SPEC) -> Study:
    return Study(small_spec(text), folder, tasks=TASKS)


# Common behaviour of all interfaces


def test_new_studies_are_checked_before_workers_start(tmp_path: Path) -> None:
    @contextmanager
    def never() -> Iterator[Session]:
        raise AssertionError("opened")
        yield

    with pytest.raises(InputError, match="known interval"):
        run_study(study(tmp_path / "demo", IN_PASCAL), never(), Entrance())
    assert not (tmp_path / "demo").exists()


def test_warnings_reach_the_user_and_the_log(tmp_path: Path) -> None:
    heard: list[str] = []
    entrance = Entrance(anyway=True, warn=heard.append, write_page=lambda folder, quick: None)
    run_study(study(tmp_path / "demo", IN_PASCAL), at_hand(Inline()), entrance)
    assert any("known interval" in text for text in heard)
    assert study(tmp_path / "demo", IN_PASCAL).ended


def test_log_and_page_are_written_after_interruption_and_completion(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    pages: list[bool] = []
    entrance = Entrance(write_page=lambda folder, quick: pages.append(quick))
    with pytest.raises(Interrupted):
        run_study(study(folder), at_hand(Stopped(after=20)), entrance)
    assert len(told(folder)) >= 20
    assert "interrupted" in StudyLayout(folder).log.read_text()
    assert run_study(study(folder), at_hand(Inline()), entrance) is not None
    assert run_study(study(folder), at_hand(Inline()), entrance) is None  # it has ended
    assert pages == [True, False]
    assert "stopped: all 5 generations are done" in StudyLayout(folder).log.read_text()


def test_crash_of_all_candidates_refers_to_the_log(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with pytest.raises(GenerationCrashError, match=r"Its traceback is in .*palpate\.log"):
        run_study(study(folder), at_hand(Crashing()), Entrance())
    assert "Traceback of a worker" in StudyLayout(folder).log.read_text()


def test_logs_of_parallel_studies_do_not_mix(tmp_path: Path) -> None:
    entrance = Entrance(write_page=lambda folder, quick: None)

    def run_one(name: str) -> None:
        own = study(tmp_path / name, SPEC.replace("demo", name))
        run_study(own, at_hand(Inline()), entrance)

    threads = [threading.Thread(target=run_one, args=(name,)) for name in ("left", "right")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name, other in (("left", "right"), ("right", "left")):
        text = StudyLayout(tmp_path / name).log.read_text()
        assert text.count("stopped: all 5 generations are done") == 1
        assert f"{other} runs on" not in text


# Each interface


def test_service_checks_new_studies_unless_overridden(tmp_path: Path) -> None:
    spec = small_spec(IN_PASCAL)
    store, opened = tmp_path / "store", Session(Inline())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="known interval"):
        run_queued_study(study_request(spec, False), tmp_path / "demo", store, opened, TASKS)
    assert not told(tmp_path / "demo")
    insisting = study_request(spec, False, anyway=True)
    run_queued_study(insisting, tmp_path / "demo", store, opened, TASKS, reports=False)
    assert len(told(tmp_path / "demo")) > 12
    assert StudyLayout(tmp_path / "demo").log.is_file()


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let Python's `Study.run` use stand-in tasks in this process."""

    def loop(*arguments: Any, **more: Any) -> Study:
        return Study(*arguments, tasks=TASKS, **more)

    monkeypatch.setattr(palpate.study, "StudyLoop", loop)
    monkeypatch.setattr(palpate.study, "chosen_session", lambda **_: at_hand(Inline()))


@pytest.mark.usefixtures("in_process")
def test_python_checks_warns_logs_and_writes_the_page(tmp_path: Path) -> None:
    unusual = SPEC.replace("E_fat_kpa: [5, 20]", "E_fat_kpa: [30, 60]")
    layout = StudyLayout(tmp_path / "demo")
    with pytest.raises(InputError, match="known interval"):
        palpate.Study(small_spec(IN_PASCAL), layout.root).run()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        palpate.Study(small_spec(unusual), layout.root).run()
    assert [w.filename for w in heard if "known interval" in str(w.message)] == [__file__]
    assert layout.log.is_file()
    assert layout.report.is_file()


@pytest.mark.usefixtures("in_process")
def test_python_raises_keyboard_interrupt_and_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = palpate.Study(small_spec(), tmp_path / "demo")
    monkeypatch.setattr(palpate.study, "chosen_session", lambda **_: at_hand(Stopped(after=15)))
    with pytest.raises(KeyboardInterrupt):
        own.run()
    monkeypatch.setattr(palpate.study, "chosen_session", lambda **_: at_hand(Inline()))
    assert own.run().stop_reason == "all 5 generations are done"


# Ctrl-C


def press_ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_first_ctrl_c_requests_a_stop_and_second_interrupts() -> None:
    before = signal.getsignal(signal.SIGINT)
    with stop_requests() as requests:
        press_ctrl_c()
        assert requests == [signal.SIGINT]
        with pytest.raises(KeyboardInterrupt):
            press_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is before


def test_nested_requests_are_shared_and_keep_foreign_handlers() -> None:
    with stop_requests() as outer, stop_requests(respect_handlers=True) as inner:
        assert inner is outer
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        with stop_requests(respect_handlers=True) as requests:
            press_ctrl_c()
    finally:
        signal.signal(signal.SIGINT, before)
    assert (heard, requests) == ([signal.SIGINT], [])


def test_other_threads_can_open_a_session_without_signals() -> None:
    found: list[list[int]] = []

    def work() -> None:
        with stop_requests() as requests:
            found.append(requests)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [[]]


def test_a_session_opens_no_workers_after_a_stop_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "open_cluster", None)
    with interruptible_exit(), interruptible() as requests:
        requests.append(signal.SIGINT)
        with session():
            pass


@contextmanager
def interruptible_exit() -> Iterator[None]:
    with pytest.raises(typer.Exit) as ended:
        yield
    assert ended.value.exit_code == INTERRUPTED


@pytest.mark.parametrize(
    ("command", "work"),
    [
        (["profile", "demo", "E_fat"], "palpate.service.commands.studies.profile.profile_of"),
        (
            ["thesis", "coefficients", "--sketch"],
            "palpate.service.commands.validation.thesis.run_thesis",
        ),
    ],
)
def test_long_commands_stop_at_ctrl_c_and_can_be_continued(
    command: list[str],
    work: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with study(Path("runs/demo")).folder.open() as journal:
        study(Path("runs/demo")).folder.begin(journal)

    class Cluster:
        client, dashboard = None, ""

    def pressed(*arguments: Any) -> None:
        press_ctrl_c()
        dispatcher = next(a for a in arguments if hasattr(a, "stop"))
        assert dispatcher.stop()
        raise Interrupted

    monkeypatch.setattr(session_module, "open_cluster", lambda *_: nullcontext(Cluster()))
    monkeypatch.setattr(session_module, "DaskRecords", lambda client: None)
    monkeypatch.setattr(work, pressed)
    assert main(command) == INTERRUPTED
    assert f"To continue: palpate {' '.join(command)}" in capsys.readouterr().err

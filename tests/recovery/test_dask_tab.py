"""Palpate's tab in Dask's dashboard."""

import asyncio
import time
import urllib.request
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bokeh.client import pull_session
from distributed import Client, LocalCluster

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.dask_dashboard import PAGE, IdleTime, PalpateTab, add_tab
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.diagnosis import diagnosis_run as dask_diagnosis
from palpate.service.diagnosis.diagnosis_run import DiagnosisRecords, Step, run_and_tell
from palpate.service.server.jobs.study_and_diagnosis_jobs import run_queued_study, study_request
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_session import DaskRecords, Session
from palpate.storage.backends.store_paths import StudyLayout
from palpate.workers.tasks.diagnosis_tasks import announcer
from tests.recovery.stand_ins import TASKS, set_manners, small_spec

DEADLINE_S = 20.0


def run_small_study(client: Client, folder: Path) -> StudyLog:
    set_manners(folder.parent / "store", seconds=0.01)
    request = study_request(small_spec(), accept_new_code=False)
    session = Session(Dispatcher(client), "", (DaskRecords(client),))
    run_queued_study(request, folder, folder.parent / "store", session, TASKS, reports=False)
    return StudyLog.read(StudyLayout(folder).journal)


def page_of(dashboard: str) -> str:
    return dashboard.removesuffix("/status") + f"/{PAGE}"


def html_of(url: str) -> str:
    with urllib.request.urlopen(url, timeout=DEADLINE_S) as answer:
        assert answer.status == 200
        return str(answer.read().decode())


def sources_of(url: str) -> dict[str, dict[str, Any]]:
    """Return the data sent to a browser, by the name of the source."""
    session = pull_session(url=url)
    try:
        names = "studies", "diagnoses", "barrier", "stages"
        return {name: dict(session.document.get_model_by_name(name).data) for name in names}
    finally:
        session.close()


def sources_at_the_end(url: str, reason: str) -> dict[str, dict[str, Any]]:
    """Return the sources after the last record, which is sent in the background."""
    end = time.monotonic() + DEADLINE_S
    while (sources := sources_of(url))["studies"]["state"] != [reason]:
        if time.monotonic() > end:
            break
        time.sleep(0.1)
    return sources


@pytest.mark.slow
def test_page_shows_the_evaluations_of_a_study(tmp_path: Path) -> None:
    with open_cluster(workers=2) as cluster:
        url = page_of(cluster.dashboard)
        assert sources_of(url)["studies"]["study"] == []
        log = run_small_study(cluster.client, tmp_path / "demo")
        assert log.end is not None
        assert "Palpate" in html_of(cluster.dashboard)  # a tab on Dask's own pages
        assert "bokeh" in html_of(url)
        sources = sources_at_the_end(url, log.end.reason)
    endings = Counter(record.status.value for record in log.endings.values())
    studies = sources["studies"]
    assert studies["study"] == ["demo"]
    assert studies["state"] == [log.end.reason]
    assert studies["ended"] == [len(log.endings)]
    assert studies["done"] == [endings["done"]]
    assert studies["diverged"] == [endings["diverged"]]
    assert sources["barrier"]["generation"] == [1, 2, 3, 4, 5]
    assert all(0.0 < percent < 100.0 for percent in sources["barrier"]["idle_percent"])
    assert sources["stages"]["stage"] == ["solve"]
    computed = sum(r.seconds["solve"] for r in log.endings.values() if not r.reused)
    assert sources["stages"]["seconds"] == pytest.approx([computed])


def test_page_shows_the_steps_of_a_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = [Step("calibration", 0, 1), Step("calibration", 1, 1, "")]
    steps += [Step("effects", n, 3, "plate_tilt, 0" if n else "") for n in range(3)]
    observed: list[Step] = []
    shown: list[str] = []

    def run(request: Any, dispatcher: Any, observe: Any) -> Any:
        for step in steps:
            dispatcher.call(time.sleep, 0.01)
            observe(step)
        shown.extend(state_of_diagnosis(url, lambda state: state.startswith("effects, 2")))
        return SimpleNamespace(summary=SimpleNamespace(verdict="no-gap"))

    monkeypatch.setattr(dask_diagnosis, "run_diagnosis", run)
    with open_cluster(workers=1) as cluster:
        url = page_of(cluster.dashboard)
        request: Any = None
        place = tmp_path / "patient-7"
        run_and_tell(request, Dispatcher(cluster.client), place, observed.append)
        shown.extend(state_of_diagnosis(url, lambda state: state == "no-gap"))
        address, security = cluster.client.scheduler.address, cluster.client.security
        with Client(address, security=security, set_as_default=False) as other:
            DiagnosisRecords(other, place)
            shown.extend(state_of_diagnosis(url, lambda state: state == "reading"))
        shown.extend(state_of_diagnosis(url, lambda state: state == "interrupted"))
        diagnoses = sources_of(url)["diagnoses"]
    assert observed == steps
    assert shown == ["effects, 2 of 3: plate_tilt, 0", "no-gap", "reading", "interrupted"]
    assert diagnoses["diagnosis"] == ["patient-7"]  # restarted, it still has one row


def announce_twice(request: Any) -> None:
    for iteration in (1, 2):
        announcer(request, "plate_tilt")(iteration)


def test_iterations_of_a_fit_reach_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[str, int]] = []
    request: Any = SimpleNamespace(name="abc")

    def run(request: Any, dispatcher: Any, observe: Any) -> Any:
        dispatcher.call(announce_twice, request)
        end = time.monotonic() + DEADLINE_S
        while len(heard) < 2 and time.monotonic() < end:
            time.sleep(0.02)
        return SimpleNamespace(summary=SimpleNamespace(verdict="no-gap"))

    monkeypatch.setattr(dask_diagnosis, "run_diagnosis", run)
    with open_cluster(workers=1) as cluster:
        dispatcher, place = Dispatcher(cluster.client), Path("patient-7")
        run_and_tell(
            request, dispatcher, place, lambda step: None, lambda fit, n: heard.append((fit, n))
        )
    announce_twice(request)  # outside a worker
    assert heard == [("plate_tilt", 1), ("plate_tilt", 2)]


def state_of_diagnosis(url: str, reached: Callable[[str], bool]) -> list[str]:
    """Return the states of the diagnoses once one of them satisfies a condition."""
    end = time.monotonic() + DEADLINE_S
    while not any(map(reached, states := sources_of(url)["diagnoses"]["state"])):
        if time.monotonic() > end:
            break
        time.sleep(0.1)
    return list(states)


def test_tab_is_added_only_once(tmp_path: Path) -> None:
    local = LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    )
    with local:
        for _ in range(2):
            with open_cluster(local.scheduler_address) as cluster:
                run_small_study(cluster.client, tmp_path / "demo")
                html_of(page_of(cluster.dashboard))
        pages = [
            a for a in local.scheduler.http_application.applications if hasattr(a, "app_paths")
        ]
        assert sum(f"/{PAGE}" in page.app_paths for page in pages) == 1


def test_scheduler_without_dashboard_has_no_tab(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "palpate.service.cluster.dask_dashboard")
    with (
        LocalCluster(
            n_workers=0,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
        ) as local,
        Client(local, set_as_default=False) as client,
    ):
        assert not add_tab(client)
        assert PalpateTab.name not in local.scheduler.plugins
    assert "has no dashboard" in caplog.text


def test_idle_time_counts_threads_without_a_task() -> None:
    now = 0.0
    idle = IdleTime(clock=lambda: now)
    idle.note([(2, 1), (0, 1)])  # a task waits behind another: one worker is busy
    now = 3.0
    idle.note([(1, 1), (1, 1)])
    now = 4.0
    idle.note([(0, 4)])
    now = 5.0
    assert idle.so_far() == (3.0 + 0.0 + 4.0, 6.0 + 2.0 + 4.0)


def test_records_arrive_in_order() -> None:
    arrived: list[str] = []
    delays_s = [0.1, 0.0]  # the first connection is the slower one

    async def log_event(topic: str, msg: dict[str, Any]) -> None:
        await asyncio.sleep(delays_s.pop(0))
        arrived.extend(record["what"] for record in msg["records"])

    async def send() -> None:
        sent: list[asyncio.Task[None]] = []
        loop = SimpleNamespace(add_callback=lambda f, *a: sent.append(asyncio.create_task(f(*a))))
        scheduler = SimpleNamespace(log_event=log_event)
        records = DaskRecords(SimpleNamespace(loop=loop, scheduler=scheduler, id="c"))
        records.generation_begun(0, 1)
        records.stopped("all generations are done")
        await asyncio.gather(*sent)

    asyncio.run(send())
    assert arrived == ["generation begun", "stopped"]

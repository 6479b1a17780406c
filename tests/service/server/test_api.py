"""The API from scripts: submit, follow, pause, resume, cancel, results, files."""

import time
from pathlib import Path
from typing import Any

import httpx
import pytest

import palpate
from palpate.service.remote_client import Client
from palpate.service.server.api_models import JobView
from palpate.storage.errors import InputError, StoreError
from palpate.storage.journal import Journal
from tests.recovery.stand_ins import SPEC, Inline, executed, run, set_manners, small_spec, told
from tests.service.server.service_process import TOKEN, ServiceProcess, until_stopped


def named(name: str, text: str = SPEC) -> str:
    return text.replace("name: demo", f"name: {name}")


def until(client: Client, identifier: str, *states: str, patience_s: float = 120.0) -> JobView:
    deadline = time.monotonic() + patience_s
    while (job := client.job(identifier)).state not in states:
        assert time.monotonic() < deadline, job
        time.sleep(0.05)
    return job


def test_a_study_over_http_equals_one_run_locally(
    service: ServiceProcess, client: Client, tmp_path: Path
) -> None:
    run(tmp_path / "here", Inline(), small_spec(named("calm")))
    job = client.submit_study(named("calm"), priority=3)
    assert (job.id, job.owner, job.priority) == ("calm", "environment", 3)
    events = list(client.follow("calm"))
    assert events[-1].kind == "end"
    assert told(service.home / "calm") == told(tmp_path / "here")

    records = [event.record for event in events if event.kind == "record"]
    journal = service.home / "calm" / "journal.jsonl"
    written = list(Journal.read(journal))
    assert records == written == list(client.journal("calm"))
    # A continued stream gives the remaining records, each once.
    position = next(e.position for e in events if e.record.get("candidate") == 7)
    rest = [e.record for e in client.follow("calm", position) if e.kind == "record"]
    assert rest == records[-len(rest) :]
    assert len(rest) < len(records)

    view = client.job("calm")
    assert view.state == "finished"
    assert view.evaluations is not None
    assert view.evaluations.done + view.evaluations.diverged == view.evaluations.at_most == 52
    best = min((r["score"]["gsf"], r["candidate"]) for r in records if r.get("score"))
    assert view.best is not None
    assert (view.best.score["gsf"], view.best.candidate) == best
    assert client.results("calm")["best"]["candidate"] == best[1]
    assert client.candidate("calm", best[1])["score"]["gsf"] == best[0]
    saved = client.download("calm", "journal.jsonl", tmp_path / "copy.jsonl")
    assert saved.read_text() == journal.read_text()


def test_a_study_can_be_paused_resumed_and_cancelled(
    service: ServiceProcess, client: Client
) -> None:
    slow = named("slow", SPEC).replace("seed: 7", "seed: 11")
    store = service.home / "store"
    set_manners(store, held_after=len(executed(store)) + 3)
    try:
        client.submit_study(slow, key="once")
        assert client.submit_study(slow, key="once").id == "slow"
        until(client, "slow", "running")
        while sum(r["kind"] == "evaluation" for r in client.journal("slow")) < 3:
            time.sleep(0.05)
        assert client.change("slow", "pause").state == "paused"
        until_stopped(service.home / "slow")
        ended = len(told(service.home / "slow"))
        set_manners(store)
        time.sleep(0.5)
        assert len(told(service.home / "slow")) == ended < 52
        client.change("slow", "resume")
        until(client, "slow", "finished")
        assert len(told(service.home / "slow")) == 52
        with pytest.raises(StoreError, match="slow is finished"):
            client.change("slow", "pause")

        set_manners(store, held_after=0)
        gone = named("gone", SPEC).replace("seed: 7", "seed: 12")
        client.submit_study(gone)
        until(client, "gone", "running")
        assert client.change("gone", "cancel").state == "cancelled"
        assert [event.kind for event in client.follow("gone")][-1] == "end"
        with pytest.raises(StoreError, match="gone is cancelled"):
            client.change("gone", "resume")
    finally:
        set_manners(store)


def test_the_urgent_study_gets_the_workers(service: ServiceProcess, client: Client) -> None:
    store = service.home / "store"
    set_manners(store, held_after=len(executed(store)) + 3)
    try:
        for name, seed, priority, generations in (("patient", 21, 0, 5), ("urgent", 22, 5, 1)):
            text = named(name).replace("seed: 7", f"seed: {seed}")
            text = text.replace("population: 12", "population: 40")
            text = text.replace("generations: 5", f"generations: {generations}")
            client.submit_study(text, priority=priority)
            until(client, name, "running")
        set_manners(store, seconds=0.05)
        until(client, "urgent", "finished")
        urgent = {record[2] for record in told(service.home / "urgent").values()}
        patient = {record[2] for record in told(service.home / "patient").values()}
        order = executed(store)
        places = sorted(map(order.index, urgent))
        assert len(places) == 40
        # What the patient one has under way ends; in generations of the urgent one it gets no
        # more, but for the last four tasks, which leave slots.
        assert len(patient.intersection(order[places[0] : places[-5]])) <= 8
        client.change("patient", "cancel")
    finally:
        set_manners(store)


def test_failed_study_has_reason_and_can_be_resumed(
    service: ServiceProcess, client: Client
) -> None:
    set_manners(service.home / "store", full_disk_above=0.012)
    text = named("full").replace("seed: 7", "seed: 31")
    client.submit_study(text)
    failed = until(client, "full", "failed")
    assert "the disk of this worker is full" in failed.reason
    set_manners(service.home / "store")
    client.change("full", "resume")
    until(client, "full", "finished")


def test_impossible_diagnosis_fails_with_message(client: Client, tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text("name: x\n")
    client.upload(tmp_path / "case.yaml", "empty-case")
    job = client.submit_diagnosis(upload="empty-case", nodes=500)
    failed = until(client, job.id, "failed")
    assert "case.yaml is not finished" in failed.reason
    with pytest.raises(InputError, match="There is no upload nix"):
        client.submit_diagnosis(upload="nix")


def test_python_client_submits_waits_and_downloads(service: ServiceProcess, tmp_path: Path) -> None:
    with palpate.connect(service.url, TOKEN) as connected:
        file = tmp_path / "face.yaml"
        file.write_text(named("face"))
        job = connected.submit(file, priority=1)
        done = job.wait(progress=True)
        assert done.state == "finished"
        assert "finished" in repr(job)
        assert job.results["estimates"]["E_fat"]["estimate"] == pytest.approx(10, rel=0.2)
        assert [r["candidate"] for r in job.candidates()] == sorted(told(service.home / "face"))
        assert job.id in [one.id for one in connected.jobs()]
        assert connected.job("face").status.priority == 1
        assert (
            job.download("study.yaml", tmp_path)
            .read_text()
            .startswith("# The settings of this study")
        )
        assert connected.cluster().threads == 2
        with pytest.raises(InputError, match="There is no job nix"):
            connected.job("nix")


def test_the_documented_example_runs(
    service: ServiceProcess,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = (Path(__file__).parents[3] / "docs" / "how-to" / "service.md").read_text()
    assert text.count("```python\n") == 1
    example = text.partition("```python\n")[2].partition("```")[0]
    (tmp_path / "demo.yaml").write_text(named("documented"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PALPATE_TOKEN", TOKEN)
    exec(example.replace("http://127.0.0.1:8780", service.url), {})
    said = capsys.readouterr()
    assert float(said.out) == pytest.approx(10, rel=0.2)
    assert (tmp_path / "study.yaml").is_file()


def test_images_of_a_study_are_uploaded_and_needed_until_it_ends(
    client: Client, tmp_path: Path, service: ServiceProcess
) -> None:
    import numpy as np

    image = tmp_path / "scan.npy"
    body = np.ones((20, 20, 20), np.uint8)
    body[5:12, 5:15, 5:15] = 2
    np.save(image, body)
    image_keys = "volume: scan.npy, spacing_mm: 3, labels: {1: fat, 2: glandular}"
    case = f"case: {{reference: {{{image_keys}}}, mesh: {{nodes: 2000}}}}"
    text = named("imaged").replace(
        "case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}", case
    )
    with pytest.raises(InputError, match="neither an upload"):
        client.submit_study(text)
    (tmp_path / "imaged.yaml").write_text(text)
    with palpate.connect(service.url, TOKEN) as connected:
        set_manners(service.home / "store", held_after=0)
        try:
            job = connected.submit(tmp_path / "imaged.yaml")
            folders = {one.folder for one in client.uploads() if one.file == "scan.npy"}
            (folder,) = folders
            with pytest.raises(StoreError, match="needs"):
                _while_waiting(client, job.id, folder)
        finally:
            set_manners(service.home / "store")
        job.wait()
    client.remove_uploads(folder)


def _while_waiting(client: Client, identifier: str, folder: str) -> None:
    client.change(identifier, "pause")
    try:
        client.remove_uploads(folder)
    finally:
        client.change(identifier, "resume")


def test_every_operation_has_a_description(service: ServiceProcess) -> None:
    described: dict[str, Any] = httpx.get(service.url + "/api/v1/openapi.json").json()
    operations = [
        operation
        for methods in described["paths"].values()
        for operation in methods.values()
        if isinstance(operation, dict)
    ]
    assert len(operations) >= 18
    assert all(operation.get("description") for operation in operations)
    numbers = httpx.get(service.url + "/metrics").text
    assert "# TYPE palpate_evaluations_total counter" in numbers

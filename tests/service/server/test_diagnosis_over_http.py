"""A computed diagnosis over HTTP, compared with `palpate diagnose`.

The scans show a phantom between plates, one of which is tilted; the service runs the real tasks
on one worker, and suspects two effects. This takes about 40 s once the kernels are compiled:

    pytest -m slow tests/service/server/test_diagnosis_over_http.py
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

import palpate
from palpate.service.cli import main
from palpate.service.diagnosis.diagnosis_run import request_for
from palpate.service.remote_client import Client, JobEvent
from palpate.storage.errors import InputError, StoreError
from palpate.workers.body.phantom.phantom_generation import generate_breast
from tests.service.diagnosis.compressed_breast import (
    PHANTOM,
    PRESSED,
    SCANS,
    described,
    write_case,
    write_scan,
    write_settings,
)
from tests.service.server.service_process import TOKEN, ServiceProcess, running_service

NODES = 600
SUSPECTS = ["plate_tilt", "segmentation_offset"]
TILT_DEG = 8.0
STUDY = """
name: searched
case:
  reference:
    phantom: {spacing_mm: 1.5, lower_mm: 30, upper_mm: 45, half_width_mm: 28, depth_mm: 32,
              glandular_fraction: 0.3, skin_mm: 0, ligament_mm: 0, compartments: 60, seed: 5}
  mesh: {nodes: 600}
  load: {force_n: 15}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 32}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [8, 80]}
  population: 4
  generations: 1
  elite: 1
seed: 3
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Provide a service with the real tasks."""
    home = tmp_path_factory.mktemp("real") / "runs"
    with running_service(home, ["--workers", "1"], "--real") as service:
        yield service


@pytest.fixture
def real_client(served: ServiceProcess) -> Iterator[Client]:
    with served.client() as connected:
        yield connected


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the folder of a case with one scan at rest and one under load."""
    folder = tmp_path_factory.mktemp("cases") / "tilted"
    return write_case(folder, {"tilt_depth": TILT_DEG}, NODES, PRESSED[1:])


@pytest.fixture
def few_suspects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit `palpate diagnose` to two suspected effects."""

    def few(source: Any, store: Any, nodes: int) -> Any:
        return request_for(source, store, nodes, effects=SUSPECTS)

    monkeypatch.setattr("palpate.service.commands.studies.diagnosing.request_for", few)


def steps(events: list[JobEvent]) -> list[tuple[str, int, int]]:
    """Return the progress in the events."""
    records = [event.record for event in events if event.kind == "record"]
    return [(r["phase"], r["done"], r["of"]) for r in records if r["kind"] == "step"]


def page_of(served: ServiceProcess, job: str) -> str:
    answer = httpx.get(f"{served.url}/api/v1/jobs/{job}/files/diagnosis.html")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert "sandbox" in answer.headers["content-security-policy"]
    return answer.text


def lasting(page: str) -> list[str]:
    """Return the lines of a page without date, command and run time."""
    return [x for x in page.splitlines() if not re.match(r"<div><dt>(Date|Run time|Command)", x)]


def diagnosed_here(
    source: Path, nodes: int, out: Path, store: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[str, dict[str, Any]]:
    """Run `palpate diagnose`; return its progress and its record."""
    command = ["diagnose", str(source), "--nodes", str(nodes), "--out", str(out), "--json"]
    assert main([*command, "--store", str(store), "--workers", "1", "--no-plan"]) == 0
    shown = capsys.readouterr()
    return shown.err, json.loads(shown.out)


@pytest.mark.slow
def test_diagnosis_over_http_equals_command(
    served: ServiceProcess,
    real_client: Client,
    case: Path,
    few_suspects: None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    client = real_client
    for name in ("case.yaml", SCANS[0], SCANS[2]):
        client.upload(case / name, "tilted")
    job = client.submit_diagnosis(upload="tilted", nodes=NODES, effects=SUSPECTS)
    assert (job.id, job.kind, job.owner) == ("tilted", "diagnosis", "environment")
    events = list(client.follow(job.id))
    assert [event.kind for event in events][-1] == "end"
    done = client.job(job.id)
    assert done.state == "finished", done
    assert done.files == ["journal.jsonl", "diagnosis.json", "diagnosis.html"]

    told = [step for step in steps(events) if step[0] != "preparation"]
    assert told[:4] == [("calibration", 0, 1), ("calibration", 1, 1)] + [
        ("effects", n, 2) for n in (0, 1)
    ]
    assert [phase for phase, done, of in told if done == of][-1] == "weighing"
    last = [event.record for event in events if event.kind == "record"][-1]
    assert (last["kind"], last["verdict"]) == ("end", "effect")

    found = client.results(job.id)
    assert (found["verdict"], found["primary"]) == ("effect", ["plate_tilt"])
    (tilt,) = [effect for effect in found["effects"] if effect["name"] == "plate_tilt"]
    assert tilt["magnitude"] == pytest.approx(TILT_DEG, rel=0.2)
    copy = client.download(job.id, "diagnosis.json", tmp_path / "copy.json")
    assert json.loads(copy.read_text()) == found

    # The same case in a separate store: recomputed, with the same record and page.
    said, here = diagnosed_here(case, NODES, tmp_path / "out", tmp_path / "store", capsys)
    assert "nothing to compute" not in said
    assert here == found
    assert (tmp_path / "out" / "diagnosis.json").read_bytes() == copy.read_bytes()
    page = page_of(served, job.id)
    assert lasting(page) == lasting((tmp_path / "out" / "diagnosis.html").read_text())
    assert "<dt>Run time</dt>" in page
    # In the store of the service it has the same digest.
    said, again = diagnosed_here(case, NODES, tmp_path / "x", served.home / "store", capsys)
    assert "nothing to compute" in said
    assert again == found


@pytest.mark.slow
def test_a_study_that_has_run_is_diagnosed(
    served: ServiceProcess, few_suspects: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "searched.yaml").write_text(STUDY)
    with palpate.connect(served.url, TOKEN) as connected:
        study = connected.submit(tmp_path / "searched.yaml")
        assert study.wait().state == "finished"
        job = connected.diagnose(study, nodes=NODES, effects=SUSPECTS)
        assert job.id == "searched-diagnosis"
        assert job.wait().state == "finished"
        found = job.results
        page = job.download("diagnosis.html", tmp_path).read_text()
    # Its target was simulated by its own model.
    assert (found["verdict"], found["primary"]) == ("no-gap", [])
    folder = served.home / "searched"
    said, here = diagnosed_here(folder, NODES, tmp_path / "out", tmp_path / "store", capsys)
    assert "nothing to compute" not in said
    assert here == found
    assert lasting(page) == lasting((tmp_path / "out" / "diagnosis.html").read_text())


def test_misspelt_effect_gives_one_message(service: ServiceProcess, tmp_path: Path) -> None:
    case = tmp_path / "misspelt"
    case.mkdir()
    for name in (SCANS[0], SCANS[2]):
        write_scan(case / name, generate_breast(PHANTOM, seed=5).labels)
    write_settings(case, described(PRESSED[1:]))
    with palpate.connect(service.url, TOKEN) as connected:
        job = connected.diagnose(case, nodes=NODES, effects=["plate_tlit"])
        with pytest.raises(InputError, match="did you mean 'plate_tilt'"):
            job.wait()
        with pytest.raises(StoreError, match="misspelt is failed and has no result"):
            _ = job.results
        with pytest.raises(InputError, match="effects"):
            connected.diagnose(case, nodes=NODES, effects=[])

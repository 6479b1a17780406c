"""Concurrent uploads, killed uploads, and uploads that name other files."""

import asyncio
import base64
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from palpate.service.server.jobs.study_and_diagnosis_jobs import bring_source
from palpate.service.server.jobs.untrusted_inputs import Limits, TooLargeError, Uploads, study_from
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from tests.cases.bench.bench_cases import described, write
from tests.recovery.stand_ins import SPEC

KIB = 1024


async def body(size: int, *, pause_s: float = 0.0, fail: bool = False) -> AsyncIterator[bytes]:
    for _ in range(size // KIB):
        await asyncio.sleep(pause_s)
        yield b"1" * KIB
    if fail:
        raise RuntimeError("gone")


def test_size_limits_of_concurrent_uploads(tmp_path: Path) -> None:
    limits = Limits(upload_bytes=100 * KIB, uploads_bytes=300 * KIB, uploads_files=1000)
    uploads = Uploads(tmp_path, limits)

    async def all_at_once() -> list[object]:
        tasks = [uploads.save("f", f"{n}.csv", body(64 * KIB, pause_s=1e-4)) for n in range(20)]
        return list(await asyncio.gather(*tasks, return_exceptions=True))

    ends = asyncio.run(all_at_once())
    assert all(isinstance(end, TooLargeError) for end in ends if isinstance(end, Exception))
    held = sum(file.stat().st_size for file in tmp_path.rglob("*"))
    assert held - (tmp_path / "f").stat().st_size <= limits.uploads_bytes
    assert not [p for p in (tmp_path / "f").iterdir() if p.name.startswith(".tmp-")]
    uploads.remove("f")
    again = asyncio.run(uploads.save("f", "a.csv", body(100 * KIB)))
    assert again.size_bytes == 100 * KIB


def test_file_limit_of_concurrent_uploads(tmp_path: Path) -> None:
    uploads = Uploads(tmp_path, Limits(uploads_files=3))

    async def all_at_once() -> list[object]:
        tasks = [uploads.save("f", f"{n}.csv", body(4 * KIB, pause_s=1e-4)) for n in range(20)]
        return list(await asyncio.gather(*tasks, return_exceptions=True))

    ends = asyncio.run(all_at_once())
    assert sum(isinstance(end, TooLargeError) for end in ends) == 17
    assert len(uploads.list()) == 3


def test_failed_uploads_do_not_count(tmp_path: Path) -> None:
    limits = Limits(upload_bytes=100 * KIB, uploads_bytes=100 * KIB)
    uploads = Uploads(tmp_path, limits)
    for _ in range(3):
        with pytest.raises(RuntimeError):
            asyncio.run(uploads.save("f", "a.csv", body(90 * KIB, fail=True)))
    (tmp_path / "f" / ".tmp-1-0123abcd-b.csv").write_bytes(bytes(90 * KIB))
    (tmp_path / ".tmp-1-0123abcd-x").mkdir()
    again = Uploads(tmp_path, limits)
    assert [path.name for path in tmp_path.rglob(".tmp-*")] == []
    assert asyncio.run(again.save("f", "a.csv", body(90 * KIB))).size_bytes == 90 * KIB
    with pytest.raises(TooLargeError):
        asyncio.run(again.save("f", "b.csv", body(20 * KIB)))
    with pytest.raises(TooLargeError):
        asyncio.run(Uploads(tmp_path, limits).save("f", "b.csv", body(20 * KIB)))


def test_checking_an_upload_does_not_stop_the_event_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[threading.Thread] = []

    def slow(path: Path, name: str) -> None:
        threads.append(threading.current_thread())
        time.sleep(0.3)

    monkeypatch.setattr("palpate.service.server.jobs.untrusted_inputs._check_upload", slow)
    uploads = Uploads(tmp_path, Limits())

    async def run() -> float:
        task = asyncio.create_task(uploads.save("f", "a.yaml", body(4 * KIB)))
        longest = 0.0
        while not task.done():
            began = time.monotonic()
            await asyncio.sleep(0.01)
            longest = max(longest, time.monotonic() - began)
        await task
        return longest

    assert asyncio.run(run()) < 0.25
    assert threads[0] is not threading.main_thread()


@pytest.mark.parametrize(
    "name", ["../../secret.csv", "SECRET", "!!binary", "!!set", "../g/a.csv", "a/../../g/a.csv"]
)
def test_a_case_reads_files_of_its_own_upload_only(tmp_path: Path, name: str) -> None:
    uploads, secret = tmp_path / "runs" / "uploads", tmp_path / "secret.csv"
    for folder in ("f", "g"):
        (uploads / folder).mkdir(parents=True)
    path = write(uploads / "f", described())
    for copy in (secret, uploads / "g" / "a.csv", uploads / "secret.csv"):
        copy.write_text((uploads / "f" / "a.csv").read_text())
    given = {
        "SECRET": str(secret),
        "!!binary": f"!!binary {base64.b64encode(str(secret).encode()).decode()}",
        "!!set": f"!!set {{{secret}}}",
    }.get(name, name)
    path.write_text(path.read_text().replace("- b.csv", f"- {given}"))
    store = str(tmp_path / "store")
    open_store(store)
    with pytest.raises(InputError, match=r"outside the|not valid YAML|is not in"):
        bring_source(str(path), store, 500, None, "", False, str(uploads / "f"))


@pytest.mark.parametrize("key", ["volume", "labels"])
@pytest.mark.parametrize("tag", ["!!binary L2V0Yy9wYXNzd2Q=", "!!set {/etc/passwd}"])
def test_file_names_in_study_must_be_strings(tmp_path: Path, key: str, tag: str) -> None:
    case = f"case: {{reference: {{volume: x, spacing_mm: 1, {key}: {tag}}}, mesh: {{nodes: 2000}}}}"
    case = case.replace("volume: x, spacing_mm: 1, volume", "spacing_mm: 1, volume")
    text = SPEC.replace("case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}", case)
    assert text != SPEC
    uploads = Uploads(tmp_path, Limits())
    with pytest.raises(InputError, match="not valid YAML"):
        study_from(text, uploads, open_store(tmp_path / "store"), Limits())

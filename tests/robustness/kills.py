"""Kills of a service at random moments of an upload and a study, with restarts."""

import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import httpx

from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from tests.recovery.stand_ins import SPEC
from tests.robustness.http_attacks import API, SIGNED, _healthy
from tests.service.server.service_process import ServiceProcess


def run(seed: int, count: int, folder: Path, log: Callable[[str], object]) -> dict[str, str]:
    """Kill a service `count` times and return the failures by kill."""
    draw = random.Random(seed)
    folder.mkdir(parents=True)
    served = ServiceProcess(folder / "runs", ["--workers", "1"]).start()
    found: dict[str, str] = {}
    try:
        with served.client() as client:
            client.submit_study(SPEC)
        for number in range(count):
            upload = threading.Thread(target=_upload, args=(served, number))
            upload.start()
            time.sleep(draw.uniform(0.0, 1.5))
            served.kill()
            upload.join()
            served.start()
            name = f"kill {number + 1}"
            found[name] = _wrong(served)
            if found[name]:
                log(f"{name}: {found[name]}")
    finally:
        with suppress(Exception):
            served.kill()
    return found


def _upload(served: ServiceProcess, number: int) -> None:
    def content() -> Iterator[bytes]:
        for _ in range(30):
            time.sleep(0.05)
            yield b"1" * 2**12

    with suppress(httpx.HTTPError, OSError):
        url = f"{served.url}{API}/uploads/f{number}/a.csv"
        httpx.put(url, content=content(), headers=SIGNED, timeout=20)


def _wrong(served: ServiceProcess) -> str:
    """Return a description of the disorder left by a killed service."""
    uploads = served.home / ".service" / "uploads"
    half = [path.name for path in uploads.rglob(".tmp-*")]
    sizes = {path.stat().st_size for path in uploads.rglob("*.csv")}
    if half or sizes - {30 * 2**12}:
        return f"half an upload is there: {half} {sizes}"
    if trouble := _healthy(served):
        return trouble
    journal = StudyLayout(served.home / "demo").journal
    if journal.is_file():
        candidates = [record.candidate for record in StudyLog.read(journal).endings.values()]
        if len(candidates) != len(set(candidates)):
            return "a candidate has two endings"
    return ""

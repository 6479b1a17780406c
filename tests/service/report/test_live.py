"""The live page of a running study: up to date, at a limited cost."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palpate.service.report.study import live_page
from palpate.service.report.study.live_page import LivePage
from palpate.storage.errors import StoreError
from tests.service.report.study_data_at_hand import study_data

ANY: Any = SimpleNamespace()


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A live page that records its times; each page takes 20 ms of computing."""
    times: list[float] = []

    def slowly(data: Any) -> str:
        until = time.thread_time() + 0.02
        while time.thread_time() < until:
            pass
        times.append(time.monotonic())
        return "<p>page</p>"

    monkeypatch.setattr(live_page, "read_study_data", lambda folder, quick: study_data())
    monkeypatch.setattr(live_page, "render_study", slowly)
    return times


def _until(reached: Any, seconds: float = 20.0) -> None:
    began = time.monotonic()
    while not reached():
        assert time.monotonic() - began < seconds
        time.sleep(0.01)


def test_writes_page_before_first_generation_ends(tmp_path: Path, written: list[float]) -> None:
    with LivePage(tmp_path) as page:
        page.started(ANY)
        page.prepared("case", ANY)
        time.sleep(0.05)
        assert not written
        page.prepared("target", ANY)
        _until(lambda: page.path.is_file())
    assert page.path.read_text() == "<p>page</p>"


def test_fast_generations_stay_within_time_share(tmp_path: Path, written: list[float]) -> None:
    """Two hundred generations in about a second: pages of 20 ms each may take a fifth of it."""
    with LivePage(tmp_path, share=0.2) as page:
        began = time.monotonic()
        page.started(ANY)
        for number in range(200):
            page.generation_ended(number, ANY)
            time.sleep(0.005)
        spent = time.monotonic() - began
        assert page.pages >= 2
        assert page.spent_s <= 0.2 * spent + 0.03
    assert len(written) == page.pages


def test_every_slow_generation_updates_page(tmp_path: Path, written: list[float]) -> None:
    with LivePage(tmp_path, share=0.9) as page:
        page.started(ANY)
        for number in range(4):
            page.generation_ended(number, ANY)
            _until(lambda number=number: page.pages == number + 1)
    assert len(written) == 4


def test_the_end_of_the_run_does_not_wait_for_a_page(tmp_path: Path, written: list[float]) -> None:
    with LivePage(tmp_path, share=1e-6) as page:
        page.started(ANY)
        page.generation_ended(0, ANY)
        _until(lambda: page.pages == 1)
        page.generation_ended(1, ANY)
        time.sleep(0.05)
        page.generation_ended(2, ANY)
        _until(lambda: page.pages == 2)  # one more, because the first does not count
        page.generation_ended(3, ANY)
        began = time.monotonic()
    assert time.monotonic() - began < 2.0
    assert page.pages == 2


def test_a_page_that_cannot_be_written_does_not_stop_the_pages(
    tmp_path: Path, written: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    full: list[bool] = [True]

    def refuses(path: Path, data: bytes) -> None:
        if full.pop() if full else False:
            raise StoreError("No space left.")
        path.write_bytes(data)

    monkeypatch.setattr(live_page, "write_file", refuses)
    with LivePage(tmp_path, share=0.9) as page:
        page.started(ANY)
        page.generation_ended(0, ANY)
        _until(lambda: page.pages == 1)
        assert not page.path.exists()
        page.generation_ended(1, ANY)
        _until(lambda: page.path.is_file())

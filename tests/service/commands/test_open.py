"""`palpate open`: the page of a folder, in a browser if there is one."""

import os
import webbrowser
from pathlib import Path

import pytest

from palpate.service.cli import main
from palpate.service.commands.studies import open_


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Provide the list of addresses opened in the browser."""
    addresses: list[str] = []
    monkeypatch.setenv("BROWSER", "a-browser")
    monkeypatch.setattr(webbrowser, "open", lambda address: addresses.append(address) or True)
    return addresses


def test_opens_the_page_of_a_diagnosis(
    tmp_path: Path, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "diagnosis.html"
    page.write_text("<p>")
    assert main(["open", str(tmp_path)]) == 0
    assert opened == [page.as_uri()]
    assert capsys.readouterr().out == f"page: {page}\n"


def test_rewrites_outdated_page(
    tmp_path: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, page = tmp_path / "journal.jsonl", tmp_path / "report.html"
    written: list[Path] = []
    monkeypatch.setattr(open_, "write_report", lambda folder: written.append(folder) or page)
    journal.write_text("")
    page.write_text("<p>")
    os.utime(journal, ns=(1, 1))
    assert main(["open", str(tmp_path)]) == 0
    assert written == []
    os.utime(journal, ns=(10**19 // 2, 10**19 // 2))
    assert main(["open", str(tmp_path)]) == 0
    assert written == [tmp_path]
    assert opened == [page.as_uri()] * 2


def test_without_a_browser_the_path_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    (tmp_path / "diagnosis.html").write_text("<p>")
    assert main(["open", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert said.out == f"page: {tmp_path / 'diagnosis.html'}\n"
    assert "No browser" in said.err


def test_rejects_a_folder_without_a_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["open", str(tmp_path)]) == 2
    assert "has no journal of a study" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

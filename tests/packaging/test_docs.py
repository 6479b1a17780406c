"""The docs build without a warning, and their pages load nothing from elsewhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# What a browser fetches by itself; a link that a reader may follow is none.
LOADS = re.compile(
    r"""(?:<(?:script|img|iframe|source|video|audio|embed|object)\b[^>]*?(?:src|data)\s*=\s*
        |<link\b[^>]*?href\s*=\s*
        |url\(\s*
        |@import\s+
        |importScripts\(\s*
        |fetch\(\s*)
        ["']?(?:https?:)?//[^\s"')>]+""",
    re.IGNORECASE | re.VERBOSE,
)
GENERATED = ("reference/commands.md", "reference/keys.md", "explanation/validation.md")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (pip install -e .[dev])")
    folder = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_in_the_navigation(site: Path) -> None:
    docs = ROOT / "docs"
    pages = {path.relative_to(docs).with_suffix("") for path in docs.rglob("*.md")}
    built = {path.relative_to(site).with_suffix("") for path in site.rglob("*.html")}
    assert built - {Path("404")} == pages
    front = (site / "index.html").read_text()
    assert all(f'href="{page}.html"' in front for page in pages - {Path("index")})


def test_pages_load_nothing_from_other_servers(site: Path) -> None:
    files = [p for p in site.rglob("*") if p.suffix in (".html", ".css", ".js")]
    assert len(files) > 10
    found = {p.name: m.group() for p in files for m in LOADS.finditer(p.read_text(errors="ignore"))}
    assert found == {}


def test_detects_loads_from_other_servers() -> None:
    assert LOADS.search('<script defer src="https://example.org/a.js"></script>')
    assert LOADS.search("<link rel='stylesheet' href='//example.org/a.css'>")
    assert LOADS.search("@font-face { src: url(http://example.org/a.woff2) }")
    assert not LOADS.search('<a href="https://example.org">a link</a>')


def test_files_referenced_by_pages_exist(site: Path) -> None:
    shown = re.compile(r'<(?:img|script|link)\b[^>]*?(?:src|href)="([^"#]+)"')
    for page in set(site.rglob("*.html")) - {site / "404.html"}:  # which a server shows anywhere
        for name in shown.findall(page.read_text()):
            file = page.parent / name.split("?")[0]
            assert name.startswith("data:") or file.is_file(), (page, name)


def test_prose_stays_within_its_budget() -> None:
    def words(*files: Path) -> int:
        return sum(len(file.read_text().split()) for file in files)

    assert words(ROOT / "README.md") <= 800
    generated = {ROOT / "docs" / name for name in GENERATED}
    assert words(*(set((ROOT / "docs").rglob("*.md")) - generated)) <= 14_400


def test_generated_pages_are_up_to_date(tmp_path: Path) -> None:
    copy = tmp_path / "docs"
    shutil.copytree(ROOT / "docs", copy)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, copy / "generate.py"], check=True, env=environment)
    for name in GENERATED[:2]:  # tests/packaging/test_figure_ages.py compares the third
        assert (copy / name).read_text() == (ROOT / "docs" / name).read_text(), (
            f"docs/{name} is not up to date: run `python docs/generate.py`"
        )


def test_every_command_is_in_the_reference(site: Path) -> None:
    text = (site / "reference" / "commands.html").read_text()
    from palpate.service.cli import COMMANDS

    names = [name for name, command in COMMANDS.items() if not command.place.endswith(":app")]
    assert len(names) > 15
    for name in names:
        assert f"Usage: palpate {name}" in text
    assert "Usage: palpate blind " in text

"""The shell blocks of README.md and docs/ run as printed, file by file, in order.

A block is marked by an HTML comment on the line before it::

    <!-- runs -->      in the folder of a checkout, with the command on the path
    <!-- slow -->      the same, but it takes minutes
    <!-- needs X -->   not here: it needs X (another machine, scans of one's own, a network)

A block without a mark fails.
"""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(
    r"(?:<!-- (?P<mark>[^>]+) -->\n)?```sh\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE
)
LIMIT_S = 1500


@dataclass(frozen=True)
class Block:
    """Shell lines, the file that contains them, and their mark."""

    file: str
    mark: str
    text: str


FILES = ("README.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md")))
BLOCKS = [
    Block(file, match["mark"] or "", match["text"])
    for file in FILES
    for match in BLOCK.finditer((ROOT / file).read_text())
]


def test_every_block_is_marked() -> None:
    assert len(BLOCKS) > 20
    for block in BLOCKS:
        assert re.fullmatch(r"runs|slow|needs .+", block.mark), (block.file, block.text)


@pytest.mark.parametrize("file", FILES)
def test_names_only_commands_that_exist(file: str) -> None:
    from palpate.service.cli import COMMANDS

    text = (ROOT / file).read_text()
    assert set(re.findall(r"(?:^|`)palpate ([a-z][a-z-]+)", text, re.MULTILINE)) <= set(COMMANDS)


@pytest.mark.parametrize("file", FILES)
def test_every_link_and_picture_exists(file: str) -> None:
    text = (ROOT / file).read_text()
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if "://" in target:
            continue
        assert (ROOT / file).parent.joinpath(target).exists(), target


@pytest.fixture
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tracked files except the packages, whose kernels are compiled here."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("README is tried in a copy of a checkout, and this is none")
    folder = tmp_path_factory.mktemp("readme") / "palpate"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in listed.stdout.decode().split("\0"):
        source = ROOT / name
        if name and source.is_file() and name.split("/")[0] not in ("palpate", "tests"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, folder / name)
    return folder


def run(block: Block, checkout: Path) -> None:
    binaries = checkout / "bin-of-tests"
    if not binaries.exists():
        binaries.mkdir()
        script = binaries / "palpate"
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m palpate "$@"\n')
        script.chmod(0o755)
    path = f"{binaries}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        cwd=checkout,
        env=os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, f"{block.text}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("file", sorted({b.file for b in BLOCKS if b.mark == "runs"}))
def test_quick_blocks_run_as_printed(file: str, checkout: Path) -> None:
    for block in BLOCKS:
        if block.file == file and block.mark == "runs":
            run(block, checkout)


@pytest.mark.slow
@pytest.mark.timeout(2 * LIMIT_S)
@pytest.mark.parametrize("file", FILES)
def test_all_blocks_run_as_printed(file: str, checkout: Path) -> None:
    """Run with pytest -m slow tests/packaging/test_readme.py; this takes half an hour."""
    for block in BLOCKS:
        if block.file == file and block.mark in ("runs", "slow"):
            run(block, checkout)

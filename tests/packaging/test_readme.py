"""The shell blocks of README.md run as they are printed, in the order in which they stand.

A block is marked in README by an HTML comment on the line before it::

    <!-- runs -->      in the folder of a checkout, with the command on the path
    <!-- slow -->      the same, but it takes minutes
    <!-- needs X -->   not here: it needs X (another machine, scans of one's own, a network)

A block without a mark fails: somebody has to say which it is.
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
PACKAGES = ("palpate", "service", "workers", "storage", "tests")


@dataclass(frozen=True)
class Block:
    """Lines of a shell, and what its mark says."""

    mark: str
    text: str


BLOCKS = [
    Block(match["mark"] or "", match["text"])
    for match in BLOCK.finditer((ROOT / "README.md").read_text())
]


def test_every_block_is_marked() -> None:
    assert len(BLOCKS) > 5
    for block in BLOCKS:
        assert re.fullmatch(r"runs|slow|needs .+", block.mark), block.text


def test_every_command_that_is_named_exists() -> None:
    from service.cli import app

    known = {command.name for command in app.registered_commands}
    known |= {group.name for group in app.registered_groups}
    readme = (ROOT / "README.md").read_text()
    named = set(re.findall(r"(?:^|`)palpate ([a-z][a-z-]+)", readme, re.MULTILINE))
    assert len(named) > 8
    assert named <= known


@pytest.fixture
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is tracked. The packages are those here, whose kernels are compiled."""
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
        if name and source.is_file() and name.split("/")[0] not in PACKAGES:
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


def test_the_quick_blocks_run_as_printed(checkout: Path) -> None:
    quick = [block for block in BLOCKS if block.mark == "runs"]
    assert quick
    for block in quick:
        run(block, checkout)


@pytest.mark.slow
@pytest.mark.timeout(2 * LIMIT_S)
def test_all_blocks_run_as_printed(checkout: Path) -> None:
    """Documented: pytest -m slow tests/packaging/test_readme.py; some ten minutes."""
    for block in BLOCKS:
        if block.mark in ("runs", "slow"):
            run(block, checkout)

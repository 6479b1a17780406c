"""The age of a figure: whether the code that makes it has changed since its commit.

A figure counts as older than the code if, since its commit, a file of that code has changed, even
by a comment, or if the code lay elsewhere then. Two moves are followed: the packages lay at the top
of the repository before they lay below ``palpate/``, and the commits listed in
``.git-blame-ignore-revs`` moved files and were meant to keep every result.
"""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import palpate

ROOT = Path(palpate.__file__).parents[1]
MOVES = ".git-blame-ignore-revs"


def history_is_known() -> bool:
    """Return True in a full clone, False in a shallow clone or without git."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        return False
    return _git("rev-parse", "--is-shallow-repository") == "false"


def is_known(commit: str) -> bool:
    """Return whether `commit` is in the history of the code."""
    return _succeeds("merge-base", "--is-ancestor", commit, "HEAD")


def date_of(commit: str) -> str:
    """Return the day of `commit`, as in 2026-11-27."""
    return _git("show", "-s", "--format=%cs", commit)


def is_older(commit: str, code: Sequence[str]) -> bool:
    """Return whether the files or folders `code` have changed since `commit`."""
    if not all(_is_in(commit, path) or _is_in(commit, _former(path)) for path in code):
        return True
    places = {*code, *map(_former, code)}
    later = _git("rev-list", "--no-merges", f"{commit}..HEAD", "--", *places).split()
    return bool(set(later) - moves()) or bool(_git("status", "--porcelain", "--", *code))


def moves() -> set[str]:
    """Return the commits that moved files and were meant to keep every result."""
    lines = (ROOT / MOVES).read_text().splitlines()
    return {line for line in lines if line and not line.startswith("#")}


def _former(path: str) -> str:
    return path.removeprefix("palpate/")


def _is_in(commit: str, path: str) -> bool:
    return _succeeds("cat-file", "-e", f"{commit}:{path}")


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _succeeds(*words: str) -> bool:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=False)
    return done.returncode == 0

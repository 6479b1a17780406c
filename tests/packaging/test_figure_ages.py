"""Every published figure carries the commit that made it; old ones say so on their page."""

import importlib
import logging
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
# A count of cases or a number with a unit, as in "14 of 22" and "0.17 mm".
FIGURE = re.compile(r"\d+ of (?:the )?\d+|\d (?:kPa|mm|%|s)(?![\w/])")
COMMIT = re.compile(r"<!--([0-9a-f]{8})-->")
MARK = "**older than the code**"


@pytest.fixture
def ages(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module("figure_ages")


@pytest.fixture
def records(ages: Any) -> list[dict[str, Any]]:
    groups = importlib.import_module("generate_validation").validation_groups()
    return [record for group in groups for record in group["records"]]


def needs_history(ages: Any) -> None:
    if not ages.history_is_known():
        pytest.skip("the ages of figures need the whole git history, and it is not here")


def readme_blocks() -> list[str]:
    """Return the paragraphs and list entries of README without its code; tables are whole."""
    text = re.sub(r"```.*?```", "", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    return [block for block in re.split(r"\n\n|\n(?=- )", text) if block.strip()]


def test_every_record_names_a_commit_and_code_that_exists(records: list[dict[str, Any]]) -> None:
    assert len(records) > 30
    for record in records:
        assert re.fullmatch("[0-9a-f]{8}", record.get("commit", "")), record["tested"]
        assert record["code"], record["tested"]
        for path in record["code"]:
            assert path.startswith("palpate/"), (record["tested"], path)
            assert (ROOT / path).exists(), (record["tested"], path)


def test_every_figure_of_the_readme_names_the_commit_of_a_record(
    records: list[dict[str, Any]],
) -> None:
    before, undated = "", []
    for block in readme_blocks():
        carrier = before if block.startswith("|") else block
        if FIGURE.search(block) and not COMMIT.search(carrier):
            undated.append(block)
        before = block
    assert undated == [], "put <!--COMMIT--> beside these figures (a table: in the text before it)"
    named = set(COMMIT.findall((ROOT / "README.md").read_text()))
    assert len(named) > 4
    assert named <= {record["commit"] for record in records}, "no record of validation.yaml"


def test_commits_of_figures_are_in_the_history(ages: Any, records: list[dict[str, Any]]) -> None:
    needs_history(ages)
    commits = {record["commit"] for record in records}
    assert [commit for commit in sorted(commits) if not ages.is_known(commit)] == []
    assert not ages.is_known("00000000")
    assert all(ages.is_known(commit) for commit in ages.moves())


def test_the_page_is_what_its_records_and_the_history_make(ages: Any) -> None:
    needs_history(ages)
    made = importlib.import_module("generate_validation").validation_page()
    page = (ROOT / "docs" / "explanation" / "validation.md").read_text()
    assert page == made, "docs/explanation/validation.md: run `python docs/generate.py`"


def test_lists_figures_that_are_older_than_their_code(
    ages: Any, records: list[dict[str, Any]]
) -> None:
    """The list is logged (``pytest -rP``); to repeat a figure is a decision, not a failure."""
    needs_history(ages)
    page = (ROOT / "docs" / "explanation" / "validation.md").read_text().splitlines()
    older = [record for record in records if ages.is_older(record["commit"], record["code"])]
    for record in older:
        logging.getLogger(__name__).warning("%s %s", record["commit"], record["tested"])
    marked = [line for line in page if line.startswith("|") and MARK in line]
    assert [line.split(" | ")[0].removeprefix("| ") for line in marked] == [
        record["tested"] for record in older
    ]


@pytest.fixture
def history(ages: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit, of a room that still lies at the top."""
    monkeypatch.setattr(ages, "ROOT", tmp_path)
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "law.py").write_text("STIFFNESS = 1\n")
    (tmp_path / ages.MOVES).write_text("# none\n")
    git(tmp_path, "init", "-q")
    commit(tmp_path)
    return tmp_path


def git(folder: Path, *words: str) -> str:
    name = ("-c", "user.name=n", "-c", "user.email=n@example.org")
    done = subprocess.run(
        ["git", *name, *words], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def commit(folder: Path) -> str:
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "--allow-empty", "-m", "m")
    return git(folder, "rev-parse", "HEAD")


def test_a_listed_move_is_no_change_and_any_other_is(ages: Any, history: Path) -> None:
    made, code = git(history, "rev-parse", "HEAD"), ["palpate/room"]
    (history / "palpate").mkdir()
    (history / "room").rename(history / "palpate" / "room")
    move = commit(history)
    assert ages.is_older(made, code)
    (history / ages.MOVES).write_text(f"# a move\n{move}\n")
    (history / "elsewhere.py").write_text("")
    commit(history)
    assert not ages.is_older(made, code)
    (history / "palpate" / "room" / "law.py").write_text("STIFFNESS = 2\n")
    assert ages.is_older(made, code)  # before it is committed
    later = commit(history)
    assert ages.is_older(made, code)
    assert not ages.is_older(later, code)


def test_code_that_lay_elsewhere_counts_as_changed(ages: Any, history: Path) -> None:
    made = git(history, "rev-parse", "HEAD")
    (history / "room").rename(history / "hall")
    move = commit(history)
    (history / ages.MOVES).write_text(f"{move}\n")
    commit(history)
    assert ages.is_older(made, ["palpate/hall"])

"""The validation page, from the records in validation.yaml, with the age of every figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from figure_ages import date_of, history_is_known, is_older

HEAD = """# Why to trust it: validation

What was tested, against which independent truth, with which result, and the command that repeats
it. Data on which a method was tuned are marked.

*Made with* is the commit whose code made a figure, or, where it was not noted, the commit that
brought the figure into the documents. A figure is **older than the code** if a file of the code
that makes it has changed since, even by a comment. Commits that moved files and were meant to keep
every result do not count (`.git-blame-ignore-revs`). Repeat an older figure before you quote it.
"""

# Key of a record, its title on the page; a column that no record of a group fills is left out.
COLUMNS = {
    "tested": "tested",
    "truth": "truth",
    "cases": "cases",
    "result": "result",
    "target": "target",
    "baseline": "baseline",
    "coverage": "coverage",
    "commit": "made with",
    "command": "repeat with",
}


def validation_groups() -> list[dict[str, Any]]:
    """Return the groups of records; a record without `code` has the code of its group."""
    groups = yaml.safe_load(Path(__file__).with_name("validation.yaml").read_text())
    for group in groups:
        group["records"] = [{"code": group["code"]} | record for record in group["records"]]
    return groups


def validation_page() -> str:
    """Return all records as tables."""
    lines = [HEAD]
    for group in validation_groups():
        lines += [f"## {group['group']}", "", group["intro"], ""]
        if "picture" in group:
            lines += [group["picture"], ""]
        lines += [*_table(group["records"]), ""]
    return "\n".join(lines)


def _table(records: Sequence[dict[str, Any]]) -> list[str]:
    used = [key for key in COLUMNS if any(key in record for record in records)]
    rows = [
        [COLUMNS[key] for key in used],
        *([_cell(record, key) for key in used] for record in records),
    ]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return [lines[0], "|" + "---|" * len(used), *lines[1:]]


def _cell(record: dict[str, Any], key: str) -> str:
    if key == "result" and "known" in record:
        return f"{record['result']} ({record['known']})"
    if key == "commit":
        return made_with(record["commit"], record["code"])
    return f"`{record[key]}`" if key == "command" else str(record.get(key, ""))


def made_with(commit: str, code: Sequence[str]) -> str:
    """Return the commit of a figure, its day, and whether the figure is older than `code`."""
    if not history_is_known():
        return f"`{commit}`"
    older = "; **older than the code**" if is_older(commit, code) else ""
    return f"`{commit}`, {date_of(commit)}{older}"

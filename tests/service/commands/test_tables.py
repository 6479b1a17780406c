"""Tables fit the terminal and are complete in a pipe."""

from io import StringIO

import pytest
from rich.console import Console

from palpate.service.commands.terminal_tables import print_table, table_lines

HEADINGS = ("candidate", "status", "reason")
REASON = "forces on the plates miss the load by 2.3 N, which is 0.02 of the load"
ROWS = [("12", "diverged", REASON), ("7", "crashed", "no memory")]


def test_pipe_gets_one_line_per_row() -> None:
    text = StringIO()
    print_table(Console(file=text, width=20), HEADINGS, ROWS)
    lines = text.getvalue().splitlines()
    assert len(lines) == 3
    assert lines[1].endswith(REASON)


@pytest.mark.parametrize("width", [12, 20, 30, 50, 80])
def test_terminal_lines_fit_without_losing_text(width: int) -> None:
    lines = table_lines(HEADINGS, ROWS, (0,), width)
    assert max(map(len, lines)) <= width
    assert " ".join(REASON.split()) in " ".join(" ".join(lines).split()) or width < 80
    for word in REASON.split():
        assert word in " ".join(lines)


def test_narrow_terminal_wraps_last_column() -> None:
    first, second, *_ = table_lines(HEADINGS, ROWS, (0,), 50)
    assert first.split() == list(HEADINGS)
    assert second.startswith("       12  diverged  forces on the plates")


def test_very_narrow_terminal_has_one_value_per_line() -> None:
    assert table_lines(HEADINGS, ROWS[1:], (0,), 20) == [
        "7",
        "  status  crashed",
        "  reason  no memory",
    ]


def test_follows_terminal_width() -> None:
    text = StringIO()
    print_table(Console(file=text, width=60, force_terminal=True), HEADINGS, ROWS)
    assert max(map(len, text.getvalue().splitlines())) <= 60

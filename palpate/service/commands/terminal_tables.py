"""Text and tables on terminals of any width, and in pipes without truncation."""

import textwrap
from collections.abc import Sequence

from rich.console import Console

from palpate.service.commands.command_line import is_quiet

Row = Sequence[str]

GAP = 2
# If the last column would be narrower than this, the row is printed as a record.
NARROWEST_TEXT = 24


def progress_console(*, stderr: bool = True) -> Console:
    """Return a console for progress and notes; see `service.commands.command_line`."""
    return Console(
        stderr=stderr, quiet=is_quiet(), highlight=False, markup=False, emoji=False, soft_wrap=True
    )


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that leaves line wrapping to the terminal, so pipes get whole lines."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False, soft_wrap=True)


def print_table(
    console: Console,
    headings: Row | None,
    rows: Sequence[Row],
    *,
    title: str = "",
    right: Sequence[int] = (),
) -> None:
    """Print a table as wide as its text, or fitted to a narrower terminal.

    Parameters
    ----------
    console : rich.console.Console
    headings : sequence of str or None
        One for each column; None for a table without headings.
    rows : sequence of sequence of str
    title : str
        A line above the table.
    right : sequence of int
        Right-aligned columns, mostly numbers.
    """
    width = console.width if console.is_terminal else None
    for text in ([title] if title else []) + table_lines(headings, rows, right, width):
        console.print(text, markup=False, highlight=False, soft_wrap=True)


def echo_table(headings: Row | None, rows: Sequence[Row], *, right: Sequence[int] = ()) -> None:
    """Print a table to standard output."""
    print_table(make_console(), headings, rows, right=right)


def table_lines(
    headings: Row | None, rows: Sequence[Row], right: Sequence[int], width: int | None
) -> list[str]:
    """Return the lines of a table.

    Each row is one line if it fits into `width`; otherwise the last column is wrapped, or the
    rows are printed as records, one value per line.

    Examples
    --------
    >>> table_lines(("name", "value"), [("E_fat", "10 kPa")], (1,), None)
    ['name    value', 'E_fat  10 kPa']
    >>> table_lines(("name", "value"), [("E_fat", "10 kPa")], (1,), 12)
    ['E_fat', '  value  10', '  kPa']
    """
    from rich.cells import cell_len

    everything = [*([headings] if headings else []), *rows]
    if not rows:
        return []
    columns = len(everything[0])
    widths = [max(cell_len(row[c]) for row in everything) for c in range(columns)]
    before = sum(widths[:-1]) + GAP * (columns - 1)
    if width is None or before + widths[-1] <= width:
        return [_line(row, widths, right) for row in everything]
    if columns - 1 not in right and width - before >= NARROWEST_TEXT:
        return [line for row in everything for line in _wrapped(row, widths, right, before, width)]
    return [line for row in rows for line in _record(headings, row, width)]


def _line(row: Row, widths: Sequence[int], right: Sequence[int]) -> str:
    from rich.cells import cell_len

    cells = []
    for column, (text, width) in enumerate(zip(row, widths, strict=True)):
        space = " " * (width - cell_len(text))
        cells.append(space + text if column in right else text + space)
    return (" " * GAP).join(cells).rstrip()


def _wrapped(
    row: Row, widths: Sequence[int], right: Sequence[int], before: int, width: int
) -> list[str]:
    parts = textwrap.wrap(row[-1], width - before) or [""]
    first = _line([*row[:-1], parts[0]], [*widths[:-1], 0], right)
    return [first, *(" " * before + part for part in parts[1:])]


def _record(headings: Row | None, row: Row, width: int) -> list[str]:
    room = max(width, 8)
    lines = textwrap.wrap(row[0], room) or [""]
    names = [""] * len(row) if headings is None else headings
    for name, text in zip(names[1:], row[1:], strict=True):
        if text:
            both = f"{name}  {text}" if name else text
            lines += textwrap.wrap(both, room, initial_indent="  ", subsequent_indent="  ")
    return lines

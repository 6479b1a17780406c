"""What a case or an experiment was understood to say, before anything runs."""

from pathlib import Path


def print_understood(source: Path) -> None:
    """Print a table on the console, and nothing for a study.

    Raises
    ------
    InputError
        If the file does not make sense.
    """
    from rich.console import Console
    from rich.table import Table

    from workers.tasks.sources import understood

    rows = understood(source)
    if not rows:
        return
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in rows:
        table.add_row(name, text)
    console = Console(stderr=True, highlight=False, markup=False)
    console.print("Understood:")
    console.print(table)


def folder_name(source: Path) -> str:
    """Return the name of the folder in runs/ for what lies at a path."""
    path = source.absolute()
    if not path.is_file():
        return path.name
    return path.parent.name if path.stem == "case" else path.stem

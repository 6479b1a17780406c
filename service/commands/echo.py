"""What a case or an experiment was understood to say, before anything runs."""

from pathlib import Path


def print_understood(source: Path) -> None:
    """Print a table on the console, and nothing for a study.

    Raises
    ------
    InputError
        If the file does not make sense.
    """
    from service.commands.tables import make_console, print_table
    from workers.tasks.sources import understood

    rows = understood(source)
    if not rows:
        return
    print_table(make_console(stderr=True), None, rows, title="Understood:")


def folder_name(source: Path) -> str:
    """Return the name of the folder in runs/ for what lies at a path."""
    path = source.absolute()
    if not path.is_file():
        return path.name
    return path.parent.name if path.stem == "case" else path.stem

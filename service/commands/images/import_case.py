"""`palpate import-case` turns a case in prose into a structured one."""

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from palpate.service.commands.echo import print_understood
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.errors import InputError
from palpate.workers.tasks.sources import structured


def import_case(
    case: Annotated[
        Path, typer.Argument(metavar="CASE", help="A case.json, or the folder containing it.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write. Default: case.yaml in the same folder.", show_default=False
        ),
    ] = None,
) -> None:
    """Convert a case to case.yaml, with the unit in every key.

    A case written in prose is rejected if a phrase is not understood; the error quotes the phrase.
    """
    folder = case if case.is_dir() else case.parent
    path = out or folder / "case.yaml"
    if path.exists():
        raise InputError(f"{path} is there already: give --out FILE, or move it away.")
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent} does not exist: make it first.")
    if path.parent.absolute() != folder.absolute():
        raise InputError(
            f"{path} is not beside {case}, and a case names its scans relative to itself: give an "
            f"--out in {folder}."
        )
    text = structured(case)
    print_understood(case)
    with explained(path):
        write_file(path, text.encode())
    typer.echo(f"Wrote {path}. To diagnose it: palpate diagnose {quote(str(path))}")

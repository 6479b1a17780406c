"""`palpate new` writes a commented file to start from: a study, a diagnosis, an experiment."""

from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from palpate.service.templates import template
from palpate.storage.backends.atomic import write_file
from palpate.storage.errors import InputError
from palpate.workers.spec import Door, Name, validated


class Kind(StrEnum):
    """What the file is about."""

    BREAST = "breast"
    BREAST_IMAGES = "breast-images"
    CORNEA = "cornea"
    DIAGNOSIS = "diagnosis"
    EXPERIMENT = "experiment"

    @property
    def command(self) -> str:
        """Return the command that takes the file."""
        return "diagnose" if self in (Kind.DIAGNOSIS, Kind.EXPERIMENT) else "run"


def new(
    kind: Annotated[
        Kind,
        typer.Argument(
            help="A study of a virtual breast (breast), of two breast images (breast-images) or of "
            "a virtual cornea (cornea); a diagnosis of breast scans; or a bench experiment."
        ),
    ],
    name: Annotated[
        str,
        typer.Argument(help="Name of the study, diagnosis or experiment; the file is NAME.yaml."),
    ],
    out: Annotated[Path | None, typer.Option(help="File to write instead of NAME.yaml.")] = None,
) -> None:
    """Write a commented file for a study, diagnosis or experiment."""

    class Wanted(Door):
        name: Name

    validated(Wanted, {"name": name}, "The name (letters, digits, '.', '_' and '-')")
    path = out or Path(f"{name}.yaml")
    if path.exists():
        raise InputError(f"{path} is there already: choose another name, or give --out FILE.")
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent} does not exist: make it first.")
    write_file(path, template(kind.value, name).encode())
    typer.echo(
        f"Wrote {path}. Fill in the keys that are marked required, then: "
        f"palpate {kind.command} {quote(str(path))}"
    )

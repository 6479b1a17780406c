"""`palpate new`: a commented study file to start from."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from storage.errors import InputError


class Kind(StrEnum):
    """What a study is about."""

    BREAST = "breast"
    BREAST_IMAGES = "breast-images"


def new(
    kind: Annotated[Kind, typer.Argument(help="A virtual breast, or two images of a breast.")],
    name: Annotated[str, typer.Argument(help="Of the study; its file becomes NAME.yaml.")],
    out: Annotated[Path | None, typer.Option(help="Another file to write.")] = None,
) -> None:
    """Write a commented study file."""
    from service.spec import Name
    from service.templates import template
    from workers.spec import Door, validated

    class Wanted(Door):
        name: Name

    validated(Wanted, {"name": name}, "The name (letters, digits, '.', '_' and '-')")
    path = out or Path(f"{name}.yaml")
    if path.exists():
        raise InputError(f"{path} is there already: choose another name, or give --out FILE.")
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent} does not exist: make it first.")
    path.write_text(template(kind.value, name), encoding="utf-8")
    typer.echo(f"Wrote {path}. Edit it, then: palpate run {path}")

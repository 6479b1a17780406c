"""The command `palpate new`."""

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from palpate.service.templates import DIAGNOSED, template, template_names
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.errors import InputError
from palpate.workers.common_keys import Door, Name, validated
from palpate.workers.mechanics.model_parameters import unknown_name


def _known(kind: str) -> str:
    if kind not in template_names():
        raise InputError(unknown_name("kind of file", kind, template_names()))
    return kind


def new(
    kind: Annotated[
        str,
        typer.Argument(
            help="A study of a virtual breast (breast), of two breast images (breast-images) or of "
            "a virtual cornea (cornea); a diagnosis of breast scans (diagnosis); a bench "
            "experiment (experiment); or a template of a plug-in.",
            autocompletion=lambda: list(template_names()),
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
        raise InputError(f"{path} already exists: choose another name, or give --out FILE.")
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent} does not exist: create it first.")
    write_file(path, template(_known(kind), name).encode())
    typer.echo(
        f"Wrote {path}. Fill in the keys marked required, then: "
        f"palpate {'diagnose' if kind in DIAGNOSED else 'run'} {quote(str(path))}"
    )

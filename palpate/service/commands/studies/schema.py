"""The command `palpate schema`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel

from palpate.service.study.study_keys import study_of
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.errors import InputError
from palpate.workers.file_keys import described_schema
from palpate.workers.mechanics.model_parameters import unknown_name
from palpate.workers.organs.organ_plugins import resolve
from palpate.workers.organs.source_registry import file_keys

DIALECT = "https://json-schema.org/draft/2020-12/schema"
STUDY = "study"


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            help="Kind of file: study, diagnosis or experiment.",
            autocompletion=lambda: [STUDY, *file_keys()],
        ),
    ],
    organ: Annotated[
        str, typer.Option(help="Organ of a study: breast, cornea, or one from a plug-in.")
    ] = "breast",
    out: Annotated[
        Path | None, typer.Option(help="Write to this file instead of standard output.")
    ] = None,
) -> None:
    """Print the keys of a file, with their meanings, as JSON schema.

    An editor that knows YAML schemas then completes and checks the file.
    """
    made = {"$schema": DIALECT} | described_schema(_model(kind, organ))
    text = json.dumps(made, indent=2, ensure_ascii=False)
    if out is None:
        typer.echo(text)
        return
    write_file(out, f"{text}\n".encode())
    typer.echo(f"Wrote {out}. Begin a file that follows it with this line:")
    typer.echo(f"# yaml-language-server: $schema={out}")


def _model(kind: str, organ: str) -> type[BaseModel]:
    if kind == STUDY:
        return study_of(organ)
    files = file_keys()
    if kind not in files:
        raise InputError(unknown_name("kind of file", kind, [STUDY, *files]))
    model: type[BaseModel] = resolve(files[kind])
    return model

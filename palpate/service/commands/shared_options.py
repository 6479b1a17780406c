"""Options shared by commands, and output of results."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.storage.json_digests import to_plain
from palpate.workers.organs.plausibility_rule import Finding

AllOption = Annotated[
    bool, typer.Option("--all", help="Also show constants at their neutral values.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON record to standard output.")
]
StoreOption = Annotated[
    str | None,
    typer.Option(
        "--store",
        metavar="FOLDER|URL",
        help="Store for volumes and evaluations: a folder, or s3://, gs:// or az://BUCKET/PREFIX. "
        "Default: $PALPATE_STORE, else runs/store.",
        show_default=False,
    ),
]
WorkersOption = Annotated[
    str | None,
    typer.Option(
        "--workers",
        metavar="N|MIN-MAX",
        help="Worker processes on this machine: 4, or 1-4 to follow the workload. "
        "Default: $PALPATE_WORKERS, else one per core.",
        show_default=False,
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the running Dask cluster at this address, such as tcp://HOST:8786. "
        "Default: $PALPATE_SCHEDULER.",
        show_default=False,
    ),
]
AnywayOption = Annotated[
    bool,
    typer.Option(
        "--anyway",
        help="Continue even if a plausibility check fails; the results then begin with a warning.",
    ),
]
StudyArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="[STUDY]",
        help="Study folder, file or name. Default: the study in runs/ that ran last.",
        show_default=False,
    ),
]


def print_findings(findings: Iterable[Finding]) -> None:
    """Print the findings of plausibility checks to standard error."""
    for finding in findings:
        typer.echo(f"Warning: {finding.text}", err=True)


def print_json(value: Any) -> None:
    """Print one indented record; infinities are the strings "-inf" and "inf"."""
    typer.echo(json.dumps(to_plain(value), indent=2, ensure_ascii=False, allow_nan=False))

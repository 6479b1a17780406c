"""The command `palpate certs`."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from palpate.service.cluster.certificates import make_certificates
from palpate.service.commands.shared_options import JsonOption, print_json


def certs(
    folder: Annotated[Path, typer.Argument(help="New or empty folder for certificates and keys.")],
    days: Annotated[
        int, typer.Option(min=1, help="Number of days for which the certificates are valid.")
    ] = 365,
    as_json: JsonOption = False,
) -> None:
    """Create TLS certificates for a Dask cluster.

    Creates a CA and certificates for scheduler, workers and clients. The environment variables that
    Dask needs are printed as shell commands: run `palpate certs tls > tls.env`, then `. tls.env`
    before every `dask scheduler --protocol tls`, `dask worker tls://HOST:8786` and
    `palpate run --scheduler tls://HOST:8786`.
    """
    made = make_certificates(folder, days)
    environment = made.environment()
    if as_json:
        print_json({"folder": str(made.folder), "days": days, "environment": environment})
        return
    for name, value in environment.items():
        typer.echo(f"export {name}={shlex.quote(value)}")
    typer.echo(
        f"{made.folder}: valid for {days} days. Anyone with a key can run code on the cluster; "
        "ca.key is needed only here.",
        err=True,
    )

"""`palpate certs` makes certificates for Dask's ports."""

import shlex
from pathlib import Path
from typing import Annotated

import typer


def certs(
    folder: Annotated[Path, typer.Argument(help="Where they go; it must be seen by all machines.")],
    host: Annotated[
        list[str] | None,
        typer.Option(help="Name or address of a machine of the cluster. Repeatable."),
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=3650, help="How long they are valid.")] = 365,
) -> None:
    """Make certificates that put the ports of Dask's scheduler and workers on TLS.

    Without them whoever reaches these ports may run code on the workers.
    """
    from service.certificates import make_certificates

    make_certificates(folder, host or (), days)
    place = shlex.quote(str(folder.expanduser().absolute()))
    typer.echo(f"certificates in {place}, valid for {days} days. On every machine:")
    typer.echo(f"  export DASK_CONFIG={place}")
    typer.echo("  dask scheduler --protocol tls --port 8786")
    typer.echo("  dask worker tls://HOST:8786 --nworkers -1 --nthreads 1")
    typer.echo("  palpate serve runs --scheduler tls://HOST:8786 --store /shared/store")

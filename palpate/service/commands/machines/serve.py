"""The command `palpate serve`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.commands.command_line import RUNS, cluster_options
from palpate.service.commands.shared_options import SchedulerOption, WorkersOption
from palpate.service.errors_and_interrupts import stop_requests
from palpate.service.server.http.http_server import listen, url_of
from palpate.service.server.http.http_server import serve as listen_and_serve
from palpate.service.server.http.request_checks import is_loopback
from palpate.service.server.jobs.untrusted_inputs import MIB, Limits
from palpate.service.server.running_service import open_service


def serve(
    home: Annotated[
        Path, typer.Argument(help="Folder for the service's studies, queue and uploads.")
    ] = RUNS,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|URL",
            help="Store for volumes and evaluations, accessible to all workers: a folder, or "
            "s3://, gs:// or az://BUCKET/PREFIX. Default: HOME/store.",
            show_default=False,
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on. Default: this machine only.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free port.")
    ] = 8780,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="Host name to accept in requests, besides localhost. Repeatable."),
    ] = None,
    read_token: Annotated[
        bool,
        typer.Option(
            help="Require a token for reading as well. Always on unless --host is this machine."
        ),
    ] = False,
    at_once: Annotated[
        int, typer.Option(min=1, help="Maximum number of jobs that run at the same time.")
    ] = 8,
    upload_mb: Annotated[
        int, typer.Option(min=1, help="Maximum size of one upload, in MiB.")
    ] = 1024,
) -> None:
    """Serve studies and diagnoses over HTTP.

    Clients can submit, follow, pause, resume and cancel jobs. Press Ctrl-C to stop the service at
    any time; the same command resumes where it stopped. Requests that change anything need a token,
    created with `palpate token new NAME`.
    """
    with stop_requests() as requests:
        address, processes = cluster_options(scheduler, workers)
        listening = listen(host, port)
        with (
            listening,
            open_service(
                home,
                lambda: open_cluster(address, processes),
                store=store,
                limits=Limits(upload_bytes=upload_mb * MIB),
                read_token=read_token or not is_loopback(host),
                at_once=at_once,
            ) as service,
        ):
            if not service.tokens:
                token = service.tokens.new("first", "admin")
                typer.echo(f"token (shown once; `palpate token` creates others): {token}")
                typer.echo(f"page (this link signs you in): {url_of(listening)}/#token={token}")
            typer.echo(f"serving {service.home.root} at {url_of(listening)}")
            listen_and_serve(service, listening, allow_host or (), stop=lambda: requests)
            typer.echo("Stopping; completed work is saved.", err=True)

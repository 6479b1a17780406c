"""`palpate slurm` makes a cluster of jobs of SLURM, for `palpate run` and `palpate serve`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from palpate.service.cluster.slurm import SlurmRequest, open_slurm
from palpate.service.cluster.worker_range import read_workers
from palpate.service.commands.interrupts import stop_requests

SAY_EVERY_S = 1.0


def slurm(
    workers: Annotated[
        str,
        typer.Option(
            metavar="N|MIN-MAX",
            help="Number of jobs, one worker each: 32, or 2-32 to follow the workload.",
        ),
    ],
    memory: Annotated[str, typer.Option(help="Memory per job.")] = "4GB",
    walltime: Annotated[str, typer.Option(help="Time limit per job.")] = "24:00:00",
    queue: Annotated[str | None, typer.Option(help="SLURM partition.")] = None,
    account: Annotated[str | None, typer.Option(help="Account to charge.")] = None,
    option: Annotated[
        list[str] | None, typer.Option(help="Additional sbatch option. Repeatable.")
    ] = None,
    setup: Annotated[
        list[str] | None,
        typer.Option(
            help="Shell command to run before the worker starts, such as 'module load python'. "
            "Repeatable."
        ),
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="Address of this machine that the workers can reach.")
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the scheduler; 0 for any free port.")
    ] = 0,
    logs: Annotated[Path | None, typer.Option(help="Folder for the output of the jobs.")] = None,
    show: Annotated[bool, typer.Option(help="Show the job script without submitting it.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Submit without asking for confirmation.")
    ] = False,
) -> None:
    """Start a scheduler here and workers as SLURM jobs.

    The job script is shown before it is submitted. Press Ctrl-C to cancel the jobs.
    """
    request = SlurmRequest(
        workers=read_workers(workers),
        memory=memory,
        walltime=walltime,
        queue=queue,
        account=account,
        options=tuple(option or ()),
        setup=tuple(setup or ()),
        host=host,
        port=port,
        logs=logs,
    )
    with stop_requests() as requests, open_slurm(request) as cluster:
        typer.echo(cluster.script)
        if show:
            return
        if not yes and not typer.confirm(f"Submit this {workers} times?", err=True):
            return
        cluster.submit()
        typer.echo(f"submitted; in another window: palpate run --scheduler {cluster.address} ...")
        if cluster.dashboard:
            typer.echo(f"dashboard: {cluster.dashboard}")
        before = -1
        while not requests:
            if (running := cluster.running) != before:
                typer.echo(f"{running} of {workers} workers are up", err=True)
                before = running
            time.sleep(SAY_EVERY_S)

"""The command `palpate cluster`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from palpate.service.cluster.batch_system_workers import (
    BatchSystem,
    JobRequest,
    check_batch_system,
    open_jobs,
)
from palpate.service.cluster.cluster_choice import read_workers
from palpate.service.errors_and_interrupts import stop_requests

SAY_EVERY_S = 1.0


def cluster(
    system: Annotated[BatchSystem, typer.Argument(help="Batch system of the cluster.")],
    workers: Annotated[
        str,
        typer.Option(
            metavar="N|MIN-MAX",
            help="Number of jobs, one worker each: 32, or 2-32 to follow the workload.",
        ),
    ],
    memory: Annotated[
        str,
        typer.Option(
            help="Memory per job. Not passed to SGE: name your site's resource with "
            "--option, for example '-l h_vmem=4G'."
        ),
    ] = "4GB",
    walltime: Annotated[str, typer.Option(help="Time limit per job.")] = "24:00:00",
    queue: Annotated[str | None, typer.Option(help="Queue, or SLURM partition.")] = None,
    account: Annotated[
        str | None, typer.Option(help="Account to charge; with LSF and SGE the project.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            help="Additional option of sbatch, qsub or bsub, such as '-V' for PBS and SGE to pass "
            "on environment variables. Repeatable."
        ),
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
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the job script and submit nothing.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Submit without asking for confirmation.")
    ] = False,
) -> None:
    """Start workers as jobs of SLURM, PBS, LSF or SGE.

    The job script is shown before it is submitted. Press Ctrl-C to cancel the jobs.
    """
    request = JobRequest(
        system=system,
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
    if not dry_run:
        check_batch_system(system)
    with stop_requests() as requests, open_jobs(request) as jobs:
        typer.echo(jobs.script)
        if not jobs.address.startswith("tls://"):
            typer.echo(
                f"{jobs.address} is not encrypted: anyone who can reach it can run code on the "
                "workers. `palpate certs` creates certificates.",
                err=True,
            )
        if dry_run:
            return
        if not yes and not typer.confirm(f"Submit this {workers} times?", err=True):
            return
        jobs.submit()
        typer.echo(f"submitted; in another window: palpate run --scheduler {jobs.address} ...")
        if jobs.dashboard:
            typer.echo(f"dashboard: {jobs.dashboard}")
        before = -1
        while not requests:
            if (running := jobs.running) != before:
                typer.echo(f"{running} of {workers} workers are up", err=True)
                before = running
            time.sleep(SAY_EVERY_S)

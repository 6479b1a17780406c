"""The command `palpate diagnose`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.service.cluster.worker_startup import forked_workers
from palpate.service.commands.command_line import cluster_options, interruptible
from palpate.service.commands.shared_options import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
)


def diagnose(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A case (case.yaml or the folder containing it), a study that has been "
            "run, or a bench experiment file.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for diagnosis.html and diagnosis.json. Default: runs/SOURCE.",
            show_default=False,
        ),
    ] = None,
    nodes: Annotated[int, typer.Option(min=200, help="Approximate number of mesh nodes.")] = 5000,
    plan: Annotated[
        bool | None,
        typer.Option(
            "--plan/--no-plan",
            help="Also find the most informative further measurement, as palpate plan does. "
            "Default: only if these scans leave several causes possible.",
            show_default=False,
        ),
    ] = None,
    anyway: AnywayOption = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find where and why a simulation differs from the real body.

    Each likely cause is reported with its magnitude.

    Press Ctrl-C to stop at any time; the same command continues the diagnosis.
    """
    scheduler, processes = cluster_options(scheduler, workers)
    with interruptible(), forked_workers(scheduler, "palpate.service.diagnosis.worker_imports"):
        # This process and the one that workers are forked from import at the same time.
        from palpate.service.commands.studies.diagnosing import DiagnosisOptions, diagnose_source

        wanted = DiagnosisOptions(out, nodes, plan, anyway, store, as_json)
        diagnose_source(source, wanted, processes, scheduler)

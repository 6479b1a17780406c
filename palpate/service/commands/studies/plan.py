"""The command `palpate plan`."""

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


def plan(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CASE_OR_STUDY",
            help="A case (case.yaml or the folder containing it), or a study that has been run.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Page to write. Default: runs/NAME/plan.html.", show_default=False),
    ] = None,
    nodes: Annotated[int, typer.Option(min=200, help="Approximate number of mesh nodes.")] = 2000,
    anyway: AnywayOption = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict which causes of a gap the scans could reveal.

    Also shows which further scan would reveal more. The loaded scans need not exist yet: only the
    reference scan is read.
    """
    scheduler, processes = cluster_options(scheduler, workers)
    with interruptible(), forked_workers(scheduler, "palpate.workers.tasks.plan_tasks"):
        # This process and the one that workers are forked from import at the same time.
        from palpate.service.commands.studies.diagnosing import PlanOptions, plan_source

        plan_source(source, PlanOptions(out, nodes, anyway, store, as_json), processes, scheduler)

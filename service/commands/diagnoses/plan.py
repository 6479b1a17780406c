"""`palpate plan`: what an acquisition can tell, before it is made."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.service.commands.common import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
    print_findings,
    print_json,
)
from palpate.service.commands.diagnoses.planning import planned
from palpate.service.commands.echo import folder_name, print_understood
from palpate.service.commands.interrupts import interruptible
from palpate.service.commands.settings import RUNS, cluster_options, store_place

if TYPE_CHECKING:
    from rich.console import Console

    from palpate.workers.diagnosis.schema.plan import PlanSummary


def plan(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CASE_OR_STUDY",
            help="A case (case.yaml, case.json or the folder containing it), or a study that has "
            "been run.",
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
    from palpate.service.cluster.fork_server import forked_workers

    scheduler, processes = cluster_options(scheduler, workers)
    with (
        interruptible(),  # from the first line that is printed on
        forked_workers(scheduler, "palpate.workers.tasks.planning"),  # while we import, too
    ):
        from dataclasses import replace

        from palpate.service.diagnosis.planning import checked_plan
        from palpate.storage.records.typed_json import to_json
        from palpate.workers.organs.study_checks import caveats_of

        print_understood(source)
        request, findings = checked_plan(source, store_place(store), nodes, anyway=anyway)
        print_findings(findings)
        summary = planned(request, processes, scheduler)
    summary = replace(summary, caveats=caveats_of(findings) or None)
    page = _write(summary, out or RUNS / folder_name(source) / "plan.html")
    if as_json:
        print_json(to_json(summary))
        return
    from palpate.service.commands.tables import make_console

    print_plan(summary, make_console())
    typer.echo(f"page: {page}")


def _write(summary: "PlanSummary", page: Path) -> Path:
    from palpate.service.report.plan.page import render
    from palpate.storage.backends.atomic import explained, write_file

    with explained(page.parent):
        page.parent.mkdir(parents=True, exist_ok=True)
    write_file(page, render(summary).encode())
    return page


def print_plan(summary: "PlanSummary", console: "Console") -> None:
    """Print what can be told and what would tell more."""
    from palpate.service.commands.tables import print_table
    from palpate.service.diagnosis.plan_words import (
        WHY,
        amounts,
        confusions,
        drift,
        gain,
        headline,
        nearest,
        silence,
    )
    from palpate.service.diagnosis.words import spoken

    for text in summary.caveats or ():
        console.print(text, soft_wrap=True)
    console.print(headline(summary), soft_wrap=True)
    rows = [
        (
            spoken(e.name),
            amounts(e.parameters, "minimum"),
            amounts(e.parameters, "plausible"),
            f"{100 * e.absorbed_share:.0f} %",
            nearest(e),
            "" if e.seen else WHY[e.why_not],
        )
        for e in summary.effects
    ]
    headings = ("effect", "found from", "plausible", "absorbed", "most alike", "")
    print_table(console, headings, rows, right=(3,))
    for text in (silence(summary), confusions(summary), drift(summary)):
        if text:
            console.print(text, soft_wrap=True)
    further = [(a.name, f"x {a.minimum_ratio:.2f}", gain(a)) for a in summary.acquisitions]
    print_table(console, ("what else could be measured", "found from", "gain"), further)
    if summary.not_simulated:
        names = ", ".join(summary.not_simulated)
        console.print(f"The model does not converge at {names}.", soft_wrap=True)

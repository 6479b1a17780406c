"""The implementation of `palpate plan`."""

from dataclasses import dataclass, replace
from pathlib import Path

import typer
from rich.console import Console

from palpate.service.cluster.worker_range import Workers
from palpate.service.commands.common import (
    print_findings,
    print_json,
)
from palpate.service.commands.echo import folder_name, print_understood
from palpate.service.commands.settings import RUNS, store_place
from palpate.service.commands.tables import make_console, print_table, progress_console
from palpate.service.commands.verbosity import note
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
from palpate.service.diagnosis.planning import checked_plan, run_plan
from palpate.service.diagnosis.progress import DiagnosisProgress
from palpate.service.diagnosis.words import spoken
from palpate.service.report.plan.page import render
from palpate.service.study.session import session
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.records.typed_json import to_json
from palpate.workers.diagnosis.schema.plan import PlanSummary
from palpate.workers.organs.study_checks import caveats_of
from palpate.workers.tasks.planning import PlanRequest, stored_plan


@dataclass(frozen=True)
class Wanted:
    """The options of the command; see `palpate plan --help`."""

    out: Path | None
    nodes: int
    anyway: bool
    store: str | None
    as_json: bool


def plan_source(
    source: Path, wanted: Wanted, workers: Workers | None, scheduler: str | None
) -> None:
    """Plan further scans of a source, write the page and print the plan."""
    print_understood(source)
    store = store_place(wanted.store)
    request, findings = checked_plan(source, store, wanted.nodes, anyway=wanted.anyway)
    print_findings(findings)
    summary = planned(request, workers, scheduler)
    summary = replace(summary, caveats=caveats_of(findings) or None)
    page = _write(summary, wanted.out or RUNS / folder_name(source) / "plan.html")
    if wanted.as_json:
        print_json(to_json(summary))
        return
    print_plan(summary, make_console())
    typer.echo(f"page: {page}")


def planned(
    request: PlanRequest,
    workers: Workers | None,
    scheduler: str | None,
) -> PlanSummary:
    """Return the plan, from the store if present."""
    done = stored_plan(request)
    if done is not None:
        note("This plan is in the store: nothing to compute.")
        return done
    with (
        session(scheduler, workers) as opened,
        DiagnosisProgress(progress_console()) as progress,
    ):
        return run_plan(request, opened.dispatcher, progress)


def _write(summary: PlanSummary, page: Path) -> Path:
    with explained(page.parent):
        page.parent.mkdir(parents=True, exist_ok=True)
    write_file(page, render(summary).encode())
    return page


def print_plan(summary: PlanSummary, console: Console) -> None:
    """Print which effects can be found, and which scans would reveal more."""
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
    headings = ("effect", "found from", "plausible", "absorbed", "most similar", "")
    print_table(console, headings, rows, right=(3,))
    for text in (silence(summary), confusions(summary), drift(summary)):
        if text:
            console.print(text, soft_wrap=True)
    further = [(a.name, f"x {a.minimum_ratio:.2f}", gain(a)) for a in summary.acquisitions]
    print_table(console, ("further measurement", "found from", "gain"), further)
    if summary.not_simulated:
        names = ", ".join(summary.not_simulated)
        console.print(f"The model does not converge for {names}.", soft_wrap=True)

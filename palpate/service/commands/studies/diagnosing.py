"""The implementation of `palpate plan` and `palpate diagnose`.

A diagnosis that leaves several causes possible plans further measurements, so both share a file.
The commands import it when they are run, at the same time as the process that workers are forked
from.
"""

import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import typer
from rich.console import Console

from palpate.service.cluster.cluster_choice import Workers
from palpate.service.commands.command_line import RUNS, note, store_place
from palpate.service.commands.shared_options import print_findings, print_json
from palpate.service.commands.studies.running import folder_name, print_understood
from palpate.service.commands.terminal_tables import make_console, print_table, progress_console
from palpate.service.diagnosis.diagnosed_constants import constant_lines, summary_json
from palpate.service.diagnosis.diagnosis_console import DiagnosisProgress, experiment_lines
from palpate.service.diagnosis.diagnosis_run import (
    PLAN_NODES,
    FinishedDiagnosis,
    checked_plan,
    finished,
    request_for,
    request_plan,
    run_and_tell,
    run_plan,
    with_caveats,
)
from palpate.service.diagnosis.diagnosis_words import (
    fitted_causes,
    is_undecided,
    power,
    sentence,
    spoken,
    strength,
)
from palpate.service.diagnosis.magnitude_words import magnitude
from palpate.service.diagnosis.plan_words import (
    WHY_NOT_FOUND,
    acquisition_worth,
    confused_effects,
    drift_advice,
    measurement_gain,
    nearest_effect,
    next_acquisitions,
    plan_headline,
    planned_amounts,
    silent_effects,
)
from palpate.service.diagnosis.reliability import reliability
from palpate.service.report.diagnosis.diagnosis_page import write_diagnosis
from palpate.service.report.diagnosis.plan_page import render_plan
from palpate.service.report.study.page_provenance import origin_of
from palpate.service.study.study_session import session
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.errors import InputError, PalpateError
from palpate.storage.json_digests import to_json
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.plan_summary import PlanSummary
from palpate.workers.organs.plausibility_rule import caveats_of
from palpate.workers.tasks.diagnosis_sources import (
    check_source,
    is_plannable,
    open_source,
    source_caveats,
)
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest
from palpate.workers.tasks.plan_tasks import PlanRequest, stored_plan


@dataclass(frozen=True)
class PlanOptions:
    """The options of the command; see `palpate plan --help`."""

    out: Path | None
    nodes: int
    anyway: bool
    store: str | None
    as_json: bool


def plan_source(
    source: Path, wanted: PlanOptions, workers: Workers | None, scheduler: str | None
) -> None:
    """Plan further scans of a source, write the page and print the plan."""
    print_understood(source)
    store = store_place(wanted.store)
    request, findings = checked_plan(source, store, wanted.nodes, anyway=wanted.anyway)
    print_findings(findings)
    summary = planned(request, workers, scheduler)
    summary = replace(summary, caveats=caveats_of(findings) or None)
    page = _write_plan_page(summary, wanted.out or RUNS / folder_name(source) / "plan.html")
    if wanted.as_json:
        print_json(to_json(summary))
        return
    print_plan(summary, make_console())
    typer.echo(f"page: {page}")


def planned(request: PlanRequest, workers: Workers | None, scheduler: str | None) -> PlanSummary:
    """Return the plan, from the store if present."""
    done = stored_plan(request)
    if done is not None:
        note("This plan is in the store: nothing to compute.")
        return done
    with session(scheduler, workers) as opened, DiagnosisProgress(progress_console()) as progress:
        return run_plan(request, opened.dispatcher, progress)


def _write_plan_page(summary: PlanSummary, page: Path) -> Path:
    with explained(page.parent):
        page.parent.mkdir(parents=True, exist_ok=True)
    write_file(page, render_plan(summary).encode())
    return page


def print_plan(summary: PlanSummary, console: Console) -> None:
    """Print which effects can be found, and which scans would reveal more."""
    for text in summary.caveats or ():
        console.print(text, soft_wrap=True)
    console.print(plan_headline(summary), soft_wrap=True)
    rows = [
        (
            spoken(e.name),
            planned_amounts(e.parameters, "minimum"),
            planned_amounts(e.parameters, "plausible"),
            f"{100 * e.absorbed_share:.0f} %",
            nearest_effect(e),
            "" if e.seen else WHY_NOT_FOUND[e.why_not],
        )
        for e in summary.effects
    ]
    headings = ("effect", "found from", "plausible", "absorbed", "most similar", "")
    print_table(console, headings, rows, right=(3,))
    for text in (silent_effects(summary), confused_effects(summary), drift_advice(summary)):
        if text:
            console.print(text, soft_wrap=True)
    further = [
        (a.name, f"x {a.minimum_ratio:.2f}", measurement_gain(a)) for a in summary.acquisitions
    ]
    print_table(console, ("further measurement", "found from", "gain"), further)
    if summary.not_simulated:
        names = ", ".join(summary.not_simulated)
        console.print(f"The model does not converge for {names}.", soft_wrap=True)


# Effects in the table: the named ones, then those with the largest gain.
SHOWN = 6


@dataclass(frozen=True)
class DiagnosisOptions:
    """The options of the command; see `palpate diagnose --help`."""

    out: Path | None
    nodes: int
    plan: bool | None
    anyway: bool
    store: str | None
    as_json: bool


def diagnose_source(
    source: Path, wanted: DiagnosisOptions, workers: Workers | None, scheduler: str | None
) -> None:
    """Diagnose a source, write the page and print the verdict.

    Raises
    ------
    InputError
        If the source is not valid, or is a bench experiment with --plan.
    """
    if wanted.plan and source.is_file() and not is_plannable(source):
        raise InputError(
            f"{source} is a bench experiment, and --plan can only suggest scans. Omit --plan."
        )
    store = store_place(wanted.store)
    opened = open_source(source, store)
    findings = check_source(opened, anyway=wanted.anyway)
    print_findings(findings)
    print_understood(source)
    request = request_for(opened, store, wanted.nodes)
    began, when = time.monotonic(), datetime.now(UTC).isoformat()
    stored = finished(request) is not None
    diagnosis = _diagnosed(request, source, workers, scheduler)
    if _to_be_planned(diagnosis.summary, source, wanted.plan):
        diagnosis = _with_plan(diagnosis, source, request, workers, scheduler)
    diagnosis = with_caveats(diagnosis, source_caveats(opened, findings))
    spent = None if stored else time.monotonic() - began
    origin = origin_of(opened, request, when, f"palpate diagnose {source}", spent)
    page = write_diagnosis(diagnosis, wanted.out or RUNS / folder_name(source), origin)
    if wanted.as_json:
        print_json(summary_json(diagnosis.summary))
        return
    print_verdict(diagnosis.summary, make_console())
    typer.echo(f"page: {page}")


def _diagnosed(
    request: DiagnosisRequest, source: Path, workers: Workers | None, scheduler: str | None
) -> FinishedDiagnosis:
    """Return the diagnosis, from the store if present."""
    stored = finished(request)
    if stored is not None:
        note("This diagnosis is in the store: nothing to compute.")
        return stored
    with session(scheduler, workers) as opened, DiagnosisProgress(progress_console()) as progress:
        return run_and_tell(request, opened.dispatcher, source, progress, progress.iterated)


def _to_be_planned(summary: Summary, source: Path, wanted: bool | None) -> bool:
    """Check whether to plan further measurements, which not every source supports."""
    return (is_undecided(summary) and is_plannable(source)) if wanted is None else wanted


def _with_plan(
    diagnosis: FinishedDiagnosis,
    source: Path,
    request: DiagnosisRequest,
    workers: Workers | None,
    scheduler: str | None,
) -> FinishedDiagnosis:
    """Add the most informative further measurements."""
    nodes = min(PLAN_NODES, request.nodes)
    try:
        asked = request_plan(source, request.store, nodes, anyway=True)
        plan = planned(asked, workers, scheduler)
    except PalpateError as error:
        typer.echo(f"Further measurements could not be evaluated. {error}", err=True)
        return diagnosis
    options = next_acquisitions(diagnosis.summary, plan)
    return replace(diagnosis, summary=replace(diagnosis.summary, next_acquisitions=options))


def print_verdict(summary: Summary, console: Console) -> None:
    """Print the verdict and the causes that were fitted, the best first."""
    for text in summary.caveats or ():
        console.print(text, soft_wrap=True)
    console.print(sentence(summary), soft_wrap=True)
    rows = [
        (spoken(e.name), strength(gain), magnitude(e), f"{100 * e.absorbed_share:.0f} %")
        for e, gain in fitted_causes(summary)[:SHOWN]
    ]
    if rows:
        print_table(console, ("cause", "evidence", "magnitude", "absorbed"), rows, right=(3,))
    if summary.primary and summary.noise is not None and (counts := reliability(summary.gain)):
        console.print(counts, soft_wrap=True)
    if summary.verdict == "no-gap" and (ruled_out := power(summary)):
        console.print(ruled_out, soft_wrap=True)
    if summary.absorbed:
        names = ", ".join(spoken(name) for name in summary.absorbed)
        console.print(
            f"Absorbed by the constants, neither confirmed nor ruled out: {names}.", soft_wrap=True
        )
    for option in summary.next_acquisitions or ():
        console.print(f"Next, {option.name}: {acquisition_worth(option)}.", soft_wrap=True)
    for line in (*constant_lines(summary), *experiment_lines(summary)):
        console.print(line, soft_wrap=True)

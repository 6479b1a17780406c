"""The implementation of `palpate diagnose`."""

import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import typer
from rich.console import Console

from palpate.service.cluster.worker_range import Workers
from palpate.service.commands.common import (
    print_findings,
    print_json,
)
from palpate.service.commands.diagnoses.planning import planned
from palpate.service.commands.echo import folder_name, print_understood
from palpate.service.commands.settings import RUNS, store_place
from palpate.service.commands.tables import make_console, print_table, progress_console
from palpate.service.commands.verbosity import note
from palpate.service.diagnosis.advice import next_acquisitions, undecided, worth
from palpate.service.diagnosis.dask_observer import run_and_tell
from palpate.service.diagnosis.experiment import experiment_lines
from palpate.service.diagnosis.planning import NODES, request_plan
from palpate.service.diagnosis.progress import DiagnosisProgress
from palpate.service.diagnosis.quotability import constant_lines, summary_json
from palpate.service.diagnosis.run import FinishedDiagnosis, finished, request_for, with_caveats
from palpate.service.diagnosis.words import ADD_UP, likely, magnitude, sentence, spoken
from palpate.service.report.diagnosis.files import write_diagnosis
from palpate.service.report.diagnosis.made import origin_of
from palpate.service.study.session import session
from palpate.storage.errors import InputError, PalpateError
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest
from palpate.workers.tasks.sources import check_source, is_plannable, open_source, source_caveats

# Effects in the table: the most probable ones.
SHOWN = 6


@dataclass(frozen=True)
class Wanted:
    """The options of the command; see `palpate diagnose --help`."""

    out: Path | None
    nodes: int
    plan: bool | None
    anyway: bool
    store: str | None
    as_json: bool


def diagnose_source(
    source: Path, wanted: Wanted, workers: Workers | None, scheduler: str | None
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
    request: DiagnosisRequest,
    source: Path,
    workers: Workers | None,
    scheduler: str | None,
) -> FinishedDiagnosis:
    """Return the diagnosis, from the store if present."""
    stored = finished(request)
    if stored is not None:
        note("This diagnosis is in the store: nothing to compute.")
        return stored
    with (
        session(scheduler, workers) as opened,
        DiagnosisProgress(progress_console()) as progress,
    ):
        return run_and_tell(request, opened.dispatcher, source, progress)


def _to_be_planned(summary: Summary, source: Path, wanted: bool | None) -> bool:
    """Check whether to plan further measurements, which not every source supports."""
    return (undecided(summary) and is_plannable(source)) if wanted is None else wanted


def _with_plan(
    diagnosis: FinishedDiagnosis,
    source: Path,
    request: DiagnosisRequest,
    workers: Workers | None,
    scheduler: str | None,
) -> FinishedDiagnosis:
    """Add the most informative further measurements."""
    nodes = min(NODES, request.nodes)
    try:
        asked = request_plan(source, request.store, nodes, anyway=True)
        plan = planned(asked, workers, scheduler)
    except PalpateError as error:
        typer.echo(f"Further measurements could not be evaluated. {error}", err=True)
        return diagnosis
    options = next_acquisitions(diagnosis.summary, plan)
    return replace(diagnosis, summary=replace(diagnosis.summary, next_acquisitions=options))


def print_verdict(summary: Summary, console: Console) -> None:
    """Print the verdict and the most probable causes."""
    for text in summary.caveats or ():
        console.print(text, soft_wrap=True)
    console.print(sentence(summary), soft_wrap=True)
    rows = [
        (spoken("no-gap"), likely(summary.no_gap_probability), "", ""),
        (spoken("none-of-these"), likely(summary.none_of_these_probability), "", ""),
    ]
    ranked = sorted(summary.effects, key=lambda e: -e.probability)
    for e in [e for e in ranked if e.name not in summary.absorbed][:SHOWN]:
        share = f"{100 * e.absorbed_share:.0f} %"
        rows.append((spoken(e.name), likely(e.probability), magnitude(e), share))
    print_table(console, ("cause", "probability", "magnitude", "absorbed"), rows, right=(1, 3))
    console.print(ADD_UP, soft_wrap=True)
    if summary.absorbed:
        names = ", ".join(spoken(name) for name in summary.absorbed)
        console.print(
            f"Absorbed by the constants, neither confirmed nor ruled out: {names}.", soft_wrap=True
        )
    for option in summary.next_acquisitions or ():
        console.print(f"Next, {option.name}: {worth(option)}.", soft_wrap=True)
    for line in (*constant_lines(summary), *experiment_lines(summary)):
        console.print(line, soft_wrap=True)

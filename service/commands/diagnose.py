"""`palpate diagnose`: why a simulated body differs from the real one."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.commands.common import (
    RUNS,
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
    print_json,
)
from service.commands.interrupts import interrupted, stop_requests

if TYPE_CHECKING:
    from service.diagnosis.run import Found
    from workers.casebook import Request

Json = dict[str, Any]
# Effects in the table: the most probable ones.
SHOWN = 6


def diagnose(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A folder with case.json and its scans, a study that has run, or the file of a "
            "bench experiment.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for diagnosis.html and diagnosis.json. Default: runs/SOURCE.",
            show_default=False,
        ),
    ] = None,
    nodes: Annotated[int, typer.Option(min=200, help="Nodes of the mesh.")] = 5000,
    plan: Annotated[
        bool | None,
        typer.Option(
            "--plan/--no-plan",
            help="Find the further measurement that would decide most, as palpate plan does. "
            "Default: where these scans leave several causes.",
            show_default=False,
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find out where simulated and real body differ, why, and by how much.

    Ctrl-C stops it at any time; the same command continues it.
    """
    from service.diagnosis.run import ask
    from storage.errors import InputError
    from workers.sources import open_source

    if plan and source.is_file():
        raise InputError(
            f"{source} is a bench experiment, and --plan knows further scans only. Leave it out."
        )
    open_source(source).check()
    request = ask(source, store or RUNS / "store", nodes)
    with stop_requests() as requests:
        found = _found(request, workers, scheduler, requests)
        if found is not None and _to_be_planned(found, source, plan):
            found = _with_plan(found, request, workers, scheduler, requests)
    if found is None:
        raise interrupted()
    page = _write(
        found, out or RUNS / (source.stem if source.is_file() else source.absolute().name)
    )
    if as_json:
        print_json(found.summary)
        return
    from rich.console import Console

    print_verdict(found.summary, Console(highlight=False))
    typer.echo(f"page: {page}")


def _found(
    request: "Request", workers: int | None, scheduler: str | None, requests: list[int]
) -> "Found | None":
    """The diagnosis; None if somebody asked to stop."""
    from rich.console import Console

    from service.cluster import open_cluster
    from service.diagnosis.progress import DiagnosisProgress
    from service.diagnosis.run import finished, run
    from service.dispatch import Dispatcher
    from service.errors import Interrupted

    done = finished(request)
    if done is not None:
        typer.echo("The store holds this diagnosis: nothing to compute.", err=True)
        return done
    try:
        if requests:
            return None
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            with DiagnosisProgress(Console(stderr=True, highlight=False)) as tell:
                return run(request, dispatcher, tell)
    except (Interrupted, KeyboardInterrupt):
        return None


def _to_be_planned(found: "Found", source: Path, wanted: bool | None) -> bool:
    """Whether more measurements are to be tried; for a bench experiment there are none."""
    from service.diagnosis.advice import undecided

    return (undecided(found.summary) and source.is_dir()) if wanted is None else wanted


def _with_plan(
    found: "Found",
    request: "Request",
    workers: int | None,
    scheduler: str | None,
    requests: list[int],
) -> "Found | None":
    """The diagnosis with what else could be measured; None if somebody asked to stop."""
    from dataclasses import replace

    from service.commands.planning import planned
    from service.diagnosis.advice import next_acquisitions
    from service.diagnosis.foresee import NODES, ask_plan
    from storage.errors import PalpateError

    nodes = min(NODES, request["nodes"])
    try:
        asked = ask_plan(Path(request["source"]), Path(request["store"]), nodes)
        plan = planned(asked, workers, scheduler, requests)
    except PalpateError as error:
        typer.echo(f"No further measurement could be tried. {error}", err=True)
        return found
    if plan is None:
        return None
    summary = found.summary | {"next_acquisitions": next_acquisitions(found.summary, plan)}
    return replace(found, summary=summary)


def _write(found: "Found", folder: Path) -> Path:
    from service.report.diagnosis_page import render
    from storage.atomic import explained, write_file
    from storage.plain import to_plain

    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(to_plain(found.summary), indent=2, ensure_ascii=False, allow_nan=False)
    write_file(folder / "diagnosis.json", text.encode() + b"\n")
    page = folder / "diagnosis.html"
    write_file(page, render(found).encode())
    return page


def print_verdict(summary: Json, console: Any) -> None:
    """A sentence, and the most probable causes, on a console."""
    from rich.table import Table

    from service.diagnosis.advice import worth
    from service.diagnosis.experiment import experiment_lines
    from service.diagnosis.words import likely, measured, sentence, spoken

    console.print(sentence(summary), soft_wrap=True)
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("cause")
    table.add_column("probability", justify="right")
    table.add_column("magnitude")
    table.add_column("absorbed", justify="right")
    for name in ("no-gap", "none-of-these"):
        probability = summary[f"{name.replace('-', '_')}_probability"]
        table.add_row(spoken(name), likely(probability), "", "")
    hidden = set(summary["absorbed"])
    ranked = sorted(summary["effects"], key=lambda e: -e["probability"])
    for e in [e for e in ranked if e["name"] not in hidden][:SHOWN]:
        magnitude = measured(e["magnitude"], e["sd"], e["unit"])
        share = f"{100 * e['absorbed_share']:.0f} %"
        table.add_row(spoken(e["name"]), likely(e["probability"]), magnitude, share)
    console.print(table)
    if hidden:
        names = ", ".join(spoken(name) for name in summary["absorbed"])
        console.print(f"Hidden in the constants, neither accused nor acquitted: {names}.",
                      soft_wrap=True)  # fmt: skip
    for option in summary.get("next_acquisitions", []):
        console.print(f"Next, {option['name']}: {worth(option)}.", soft_wrap=True)
    for line in experiment_lines(summary):
        console.print(line, soft_wrap=True)

"""`palpate plan`: what an acquisition can tell, before it is made."""

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
from service.commands.planning import planned

if TYPE_CHECKING:
    from rich.console import Console

Json = dict[str, Any]


def plan(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CASE_OR_STUDY",
            help="A folder with case.json and its reference scan, or a study that has run.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The page. Default: runs/NAME/plan.html.", show_default=False),
    ] = None,
    nodes: Annotated[int, typer.Option(min=200, help="Nodes of the mesh.")] = 2000,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """See which causes of a gap scans could show, and which further scan would show more.

    Loaded scans need not exist: only the reference scan is read.
    """
    from service.diagnosis.foresee import ask_plan

    request = ask_plan(source, store or RUNS / "store", nodes)
    with stop_requests() as requests:
        found = planned(request, workers, scheduler, requests)
    if found is None:
        raise interrupted()
    page = _write(found, out or RUNS / source.absolute().name / "plan.html")
    if as_json:
        print_json(found)
        return
    from rich.console import Console

    print_plan(found, Console(highlight=False))
    typer.echo(f"page: {page}")


def _write(found: Json, page: Path) -> Path:
    from service.report.plan_page import render
    from storage.atomic import explained, write_file

    with explained(page.parent):
        page.parent.mkdir(parents=True, exist_ok=True)
    write_file(page, render(found).encode())
    return page


def print_plan(found: Json, console: "Console") -> None:
    """What can be told and what would tell more, on a console."""
    from rich.table import Table

    from service.diagnosis.plan_words import (
        WHY,
        amounts,
        confusions,
        drift,
        gain,
        headline,
        nearest,
        silence,
    )
    from service.diagnosis.words import spoken

    console.print(headline(found), soft_wrap=True)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("effect", "found from", "plausible", "absorbed", "most alike", ""):
        table.add_column(title, justify="right" if title == "absorbed" else "left")
    for e in found["effects"]:
        table.add_row(
            spoken(e["name"]),
            amounts(e["parameters"], "minimum"),
            amounts(e["parameters"], "plausible"),
            f"{100 * e['absorbed_share']:.0f} %",
            nearest(e),
            "" if e["seen"] else WHY[e["why_not"]],
        )
    console.print(table)
    for text in (silence(found), confusions(found), drift(found)):
        if text:
            console.print(text, soft_wrap=True)
    further = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("what else could be measured", "found from", "gain"):
        further.add_column(title)
    for a in found["acquisitions"]:
        further.add_row(a["name"], f"x {a['minimum_ratio']:.2f}", gain(a))
    console.print(further)
    if found["not_simulated"]:
        names = ", ".join(found["not_simulated"])
        console.print(f"The model does not converge at {names}.", soft_wrap=True)

"""The commands of `palpate blind`."""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer
from rich.console import Console

from palpate.service.blind.answering.progress import SetProgress
from palpate.service.blind.answering.run import Answering, answer, unanswered
from palpate.service.blind.answering.run import seal as seal_answers
from palpate.service.blind.making.case import make_case
from palpate.service.blind.making.set import SetRequest, plan, seal, unmade
from palpate.service.blind.making.set import make as make_cases
from palpate.service.blind.report.markdown import filled
from palpate.service.blind.report.page import render
from palpate.service.blind.report.words import interval, limit, shown
from palpate.service.blind.scoring.metrics import Metric
from palpate.service.blind.scoring.score import record, score_sets
from palpate.service.blind.scoring.scored_set import ScoredSet
from palpate.service.blind.sealed.sets import BlindSet, Truths, read_manifest
from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.cluster.worker_range import Workers
from palpate.service.commands.common import (
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
    print_json,
)
from palpate.service.commands.interrupts import interruptible
from palpate.service.commands.settings import cluster_options, store_place
from palpate.service.commands.tables import make_console, print_table, progress_console
from palpate.service.study.session import session
from palpate.storage.backends.atomic import write_file
from palpate.storage.errors import InputError
from palpate.workers.blind.random_case import CONTROL, KINDS
from palpate.workers.blind.world import World

NODES = 5000

app = typer.Typer(
    help="Test the diagnosis on cases whose true causes are sealed.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class Which(StrEnum):
    """Scans given to a diagnosis."""

    all = "all"
    y = "y"


SetArgument = Annotated[Path, typer.Argument(metavar="SET", help="Folder of the set.")]
TruthOption = Annotated[
    Path | None,
    typer.Option(help="Folder of the truths. Default: SET-truth.", show_default=False),
]
DirectionsOption = Annotated[
    Which, typer.Option(help="Scans given to the diagnosis: all, or only those compressed along y.")
]


@app.command("make")
def make(
    folder: SetArgument,
    cases: Annotated[int, typer.Option(min=1, help="Number of cases.")] = 60,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Random seed of the set. Default: chosen at random and kept secret.",
            show_default=False,
        ),
    ] = None,
    one_direction: Annotated[
        bool, typer.Option("--one-direction", help="Compress all bodies along y only.")
    ] = False,
    controls: Annotated[
        bool,
        typer.Option(
            "--controls", help="Make only controls, without a hidden cause (null replicates)."
        ),
    ] = False,
    world: Annotated[
        World,
        typer.Option(
            help="Everything but the cause: as in the model (plain) or slightly off (hard)."
        ),
    ] = World.plain,
    truth: TruthOption = None,
    nodes: Annotated[
        int, typer.Option(min=200, help="Approximate number of mesh nodes of the sealed diagnosis.")
    ] = NODES,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Generate random cases and their truths, and seal both.

    The truths are kept in a separate folder. Press Ctrl-C to stop at any time; the same command
    continues.
    """
    scheduler, processes = cluster_options(scheduler, workers)
    blind = BlindSet(folder)
    truths = Truths(truth or blind.truth_beside())
    _refuse_nested(folder, truths.root)
    request = SetRequest(cases, seed, one_direction, nodes, controls, world.value)
    entries = plan(blind, truths, request, {CONTROL: 1.0} if controls else KINDS)
    waiting = unmade(blind, truths, entries)

    def work(dispatcher: Dispatcher, console: Console) -> None:
        with SetProgress(console, "made", len(entries) - len(waiting), len(entries)) as tell:
            make_cases(blind, truths, waiting, request, dispatcher, tell, make_case)

    if waiting:
        _with_workers(work, scheduler, processes)
    sealed = seal(blind, truths, entries, request)
    typer.echo(f"{len(entries)} cases in {folder}, their truths in {truths.root}")
    typer.echo(f"manifest: sha256 {sealed}")


@app.command("run")
def run(
    folder: SetArgument,
    directions: DirectionsOption = Which.all,
    limit: Annotated[
        int | None,
        typer.Option(min=1, help="Maximum number of cases to answer now.", show_default=False),
    ] = None,
    nodes: Annotated[int, typer.Option(min=200, help="Approximate number of mesh nodes.")] = NODES,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    declare: Annotated[
        str | None,
        typer.Option(
            metavar="REASON",
            help="Reason why the diagnosis differs from the sealed one.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Diagnose every case of a set and seal the answers.

    The answers are sealed once all are complete. Press Ctrl-C to stop at any time; the same command
    continues.
    """
    scheduler, processes = cluster_options(scheduler, workers)
    answering = Answering(
        BlindSet(folder), store_place(store), directions.value, nodes, limit, declare
    )
    waiting = unanswered(answering)
    of = len(read_manifest(answering.blind)["cases"])

    def work(dispatcher: Dispatcher, console: Console) -> None:
        with SetProgress(console, "answered", of - len(waiting), of) as tell:
            answer(answering, waiting, dispatcher, tell)

    if waiting:
        _with_workers(work, scheduler, processes)
    sealed = seal_answers(answering)
    if sealed is None:
        left = len(unanswered(answering))
        typer.echo(f"{of - left} of {of} cases are answered; the same command continues.")
        return
    typer.echo(f"answers: sha256 {sealed}")
    typer.echo(f"next: palpate blind score {quote(str(folder))}" + _directions(directions))


@app.command("score")
def score(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="SET...", help="Folders of the sets; several are scored as one."),
    ],
    truth: TruthOption = None,
    directions: DirectionsOption = Which.all,
    page: Annotated[
        Path | None, typer.Option(help="Also write an HTML page to this file.", show_default=False)
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Insert the figures into this text file, between its two markers.",
            show_default=False,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Score the sealed answers of sets against their truths."""
    if truth is not None and len(folders) > 1:
        raise InputError(
            f"--truth names the truths of one set, found {len(folders)} sets. Omit it if "
            "they are next to their sets, as SET-truth, or score one set at a time."
        )
    sets = [BlindSet(folder) for folder in folders]
    opened = [(blind, Truths(truth or blind.truth_beside())) for blind in sets]
    scored = score_sets(opened, directions.value)
    if page is not None:
        _write(page, scored)
    if into is not None:
        _put_into(into, scored)
    if as_json:
        print_json(record(scored))
        return
    _print(scored, make_console())
    if page is not None:
        typer.echo(f"page: {page}")


def _refuse_nested(folder: Path, truth: Path) -> None:
    """Reject truths inside the set, which others receive, and a set inside the truths."""
    a, b = folder.absolute().resolve(), truth.absolute().resolve()
    if a == b or a in b.parents or b in a.parents:
        raise InputError(
            f"The truths must be outside the set: found {truth} and {folder}. Give another folder "
            "with --truth."
        )


def _with_workers(
    work: Callable[[Dispatcher, Console], None], scheduler: str | None, workers: Workers | None
) -> None:
    """Run a function with a cluster; exit with 130 if the user asks to stop."""
    with interruptible(), session(scheduler, workers) as opened:
        work(opened.dispatcher, progress_console())


def _directions(which: Which) -> str:
    return "" if which is Which.all else f" --directions {which.value}"


def _write(page: Path, scored: ScoredSet) -> None:
    write_file(page, render(scored).encode())


def _put_into(text: Path, scored: ScoredSet) -> None:
    if not text.is_file():
        raise InputError(f"--into {text}: no such file. Give a text file with the two markers.")
    write_file(text, filled(text.read_text(encoding="utf-8"), scored).encode())


def _print(scored: ScoredSet, console: Console) -> None:
    """Print all metrics on a console, those with a target first."""
    rows = [_cells(metric) for metric in scored.targets_first]
    print_table(console, ("figure", "value", "95 %", "cases", "target", ""), rows, right=(1, 3))
    if scored.floor_mm is not None:
        console.print(f"Floor: {scored.floor_mm:.3f} mm of true gap in the median control.")


def _cells(metric: Metric) -> tuple[str, ...]:
    met = {None: "", True: "met", False: "not met"}[metric.met]
    estimate = metric.estimate
    value = shown(estimate.value, metric.unit)
    return metric.title, value, interval(metric), str(estimate.count), limit(metric), met

"""The commands of `palpate blind`, and their progress: a bar on a terminal, lines elsewhere."""

import time
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from palpate.service.blind.answer_statistics import reliability
from palpate.service.blind.blind_page import (
    RELIABILITY,
    comparison,
    metric_cells,
    reliability_cells,
    render,
    with_metrics,
)
from palpate.service.blind.sealed_set import BlindSet, Truths, read_manifest
from palpate.service.blind.set_answering import Answering, answer, unanswered
from palpate.service.blind.set_answering import seal as seal_answers
from palpate.service.blind.set_making import SetRequest, make_case, plan, seal, unmade
from palpate.service.blind.set_making import make as make_cases
from palpate.service.blind.set_scoring import ScoredSet, score_record, score_sets
from palpate.service.cluster.cluster_choice import Workers
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.commands.command_line import cluster_options, interruptible, store_place
from palpate.service.commands.shared_options import (
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
    print_json,
)
from palpate.service.commands.terminal_tables import make_console, print_table, progress_console
from palpate.service.study.study_progress import clock
from palpate.service.study.study_session import session
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.errors import InputError
from palpate.workers.blind.case_deviations import World
from palpate.workers.blind.random_case import CONTROL, KINDS

LINE_EVERY_S = 10.0


class SetProgress:
    """Progress bar for cases, on standard error.

    Parameters
    ----------
    console : rich.console.Console
    what : str
        The operation, such as "made".
    done, of : int
        Numbers of cases.
    """

    def __init__(self, console: Console, what: str, done: int, of: int) -> None:
        self.console, self.what, self.done, self.of = console, what, done, of
        self._begun = self._last = time.monotonic()
        self._bar: Progress | None = None
        if console.is_terminal:
            columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=console)
            self._task = self._bar.add_task(what, total=of, completed=done)

    def __enter__(self) -> "SetProgress":
        if self._bar is not None:
            self._bar.start()
        else:
            self._line(f"{self.of} cases, {self.done} of them already {self.what}")
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, note: str = "") -> None:
        """Count one more case; a note is printed on a separate line."""
        self.done += 1
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done)
        due = time.monotonic() - self._last >= LINE_EVERY_S
        if note or (self._bar is None and (due or self.done == self.of)):
            self._line(
                f"{self.done} of {self.of} cases {self.what}" + (f": {note}" if note else "")
            )

    def _line(self, text: str) -> None:
        self._last = time.monotonic()
        spent = clock(self._last - self._begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)


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
    Path | None, typer.Option(help="Folder of the truths. Default: SET-truth.", show_default=False)
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
        print_json(score_record(scored))
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
    write_file(text, with_metrics(text.read_text(encoding="utf-8"), scored).encode())


def _print(scored: ScoredSet, console: Console) -> None:
    """Print all metrics on a console, those with a target first, and the reliability."""
    rows = [metric_cells(metric) for metric in scored.targets_first]
    print_table(console, ("figure", "value", "95 %", "cases", "target", ""), rows, right=(1, 3))
    if scored.floor_mm is not None:
        console.print(f"Floor: {scored.floor_mm:.3f} mm of true gap in the median control.")
    console.print()
    print_table(console, RELIABILITY, [*map(reliability_cells, reliability(scored.records))])
    console.print("Effects that cannot be told apart are counted if one of them acts.")
    if told := comparison(scored.metrics):
        console.print(told, markup=False, highlight=False, soft_wrap=True)

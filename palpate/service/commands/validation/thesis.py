"""The command `palpate thesis`, with its progress on standard error."""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from palpate.service.cluster.cluster_choice import Workers, most_workers
from palpate.service.cluster.dask_cluster import usable_cores
from palpate.service.commands.command_line import (
    RUNS,
    cluster_options,
    interruptible,
    note,
    store_place,
)
from palpate.service.commands.shared_options import (
    JsonOption,
    SchedulerOption,
    StoreOption,
    WorkersOption,
    print_json,
)
from palpate.service.commands.terminal_tables import make_console, print_table, progress_console
from palpate.service.number_formatting import duration
from palpate.service.study.study_progress import clock
from palpate.service.study.study_session import session
from palpate.service.thesis.remaining_time import estimate
from palpate.service.thesis.thesis_book import write_all
from palpate.service.thesis.thesis_experiments import (
    EXPERIMENTS,
    POLISHED,
    Step,
    ThesisRequest,
    run_thesis,
)
from palpate.service.thesis.thesis_results import ThesisResults, thesis_results
from palpate.service.thesis.thesis_verdicts import verdicts
from palpate.storage.errors import InputError
from palpate.storage.json_digests import to_json
from palpate.workers.thesis.phantom_compression import Scale

LINE_EVERY_S = 10.0


class ThesisProgress:
    """A bar for each phase or search; occasional lines in a log.

    Parameters
    ----------
    console : rich.console.Console
        The console of standard error.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self._begun = time.monotonic()
        self._last = 0.0
        self._cpu_s = 0.0
        self._bars: Progress | None = None
        self._tasks: dict[str, int] = {}
        if console.is_terminal:
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
            self._bars = Progress(*columns, TimeElapsedColumn(), console=console)

    def __enter__(self) -> "ThesisProgress":
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, step: Step) -> None:
        """Display one step."""
        self._cpu_s += step.cpu_s
        title = f"{step.experiment}: {step.title}"
        if self._bars is not None:
            if title not in self._tasks:
                self._tasks[title] = self._bars.add_task(title, total=step.of)
            self._bars.update(self._tasks[title], completed=step.done)  # type: ignore[arg-type]
            return
        now = time.monotonic()
        if not step.label or step.done == step.of or now - self._last >= LINE_EVERY_S:
            self._last = now
            label = f": {step.label}" if step.label else ""
            text = f"{title}, {step.done} of {step.of}{label}"
            spent = f"{clock(now - self._begun)}, {duration(self._cpu_s)} of processor time"
            self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)


EVERYTHING = ("all", "book")


def thesis(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="Experiment: coefficients, mesh-quality, mammogram, search, sensitivity, cornea, "
            "or all.",
        ),
    ],
    full: Annotated[
        bool, typer.Option("--full", help="Run at the thesis' own scale; takes hours to days.")
    ] = False,
    sketch: Annotated[bool, typer.Option("--sketch", help="Run a coarse, quick preview.")] = False,
    out: Annotated[
        Path, typer.Option(help="Folder for the page, its JSON, mammograms and studies.")
    ] = RUNS / "thesis",
    strategy: Annotated[
        str | None,
        typer.Option(
            help="Search strategy, as search.strategy in a study; the thesis uses genetic. "
            "Default: genetic+least-squares, with the genetic stage reported separately.",
            show_default=False,
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only estimate the running time.")
    ] = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the thesis' experiments and check its published values.

    Runs at a reduced scale unless --full is given. Press Ctrl-C to stop at any time; the same
    command continues and reuses results in the store.
    """
    scheduler, processes = cluster_options(scheduler, workers)
    request = _request(name, full, sketch, out, strategy, store)
    about = estimate(request, most_workers(processes or usable_cores()))
    text = f"thesis {name}, {request.scale} scale: {about.sentence}"
    if dry_run:
        typer.echo(text, err=True)
        return
    note(text)
    if about.missing:
        with interruptible():
            _complete(request, processes, scheduler)
    _show(request, name, as_json)


def _request(
    name: str, full: bool, sketch: bool, out: Path, strategy: str | None, store: str | None
) -> ThesisRequest:
    if name not in (*EXPERIMENTS, *EVERYTHING):
        raise InputError(
            f"There is no experiment {name}. Choose one of {', '.join(EXPERIMENTS)}, or all."
        )
    if full and sketch:
        raise InputError("--full and --sketch cannot be combined: give one of them.")
    scale: Scale = "full" if full else "sketch" if sketch else "reduced"
    chosen = EXPERIMENTS if name in EVERYTHING else [e for e in EXPERIMENTS if e == name]
    home = store_place(store)
    folder = out.expanduser().absolute()
    return ThesisRequest(chosen, scale, home, folder, strategy or POLISHED)


def _complete(request: ThesisRequest, workers: Workers | None, scheduler: str | None) -> None:
    """Run the missing parts to the end."""
    with session(scheduler, workers) as opened, ThesisProgress(progress_console()) as progress:
        run_thesis(request, opened.dispatcher, progress)


def _show(request: ThesisRequest, name: str, as_json: bool) -> None:
    results = thesis_results(request)
    page = write_all(results, request, "book" if name in EVERYTHING else name)
    if as_json:
        print_json(to_json(results))
        return
    print_verdicts(results, make_console())
    typer.echo(f"page: {page}")


def print_verdicts(results: ThesisResults, console: Console) -> None:
    """Print the published values of the experiments that were run, next to ours."""
    rows = [
        (v.place, v.what, v.printed, v.found, v.word)
        for v in verdicts(results)
        if v.word not in ("not run", "cannot be")
    ]
    print_table(console, ("where", "what", "thesis", "palpate", "verdict"), rows, right=(2, 3))

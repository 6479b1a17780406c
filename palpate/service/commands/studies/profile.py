"""The command `palpate profile`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from palpate.service.commands.command_line import cluster_options, interruptible
from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import (
    JsonOption,
    SchedulerOption,
    WorkersOption,
    print_json,
)
from palpate.service.commands.terminal_tables import make_console, print_table
from palpate.service.number_formatting import number
from palpate.service.results.profile_likelihood import Profile, profile_of
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_session import session
from palpate.service.study.task_requests import Tasks
from palpate.workers.common_keys import validated


def profile(
    study: Annotated[Path, typer.Argument(help="Study folder, file or name.")],
    name: Annotated[str, typer.Argument(help="Searched constant to hold, such as eta_glandular.")],
    points: Annotated[int, typer.Option(min=3, max=101, help="Number of values to try.")] = 9,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show how well the image is fitted as one constant varies.

    The constant is held at several values, and the others are refitted at each. Press Ctrl-C to
    stop at any time; the same command continues from the evaluations in the store.
    """
    with interruptible():  # before the imports, which take a while
        scheduler, processes = cluster_options(scheduler, workers)
        folder = find_study(study)
        record, log = read_study(folder)
        spec = validated(StudySpec, record.spec, f"The study in {folder}")
        with session(scheduler, processes) as opened:
            curve = profile_of(spec, log, Tasks(), opened.dispatcher, name, points)
    if as_json:
        print_json(asdict(curve))
    else:
        _print(curve)


def _print(found: Profile) -> None:
    console = make_console()
    others = [gene for gene in found.points[0].genes if gene != found.gene]
    rows = [
        (
            number(p.value),
            "failed" if p.rise is None else f"{p.rise:.2f}",
            "-" if p.score is None else f"{p.score:.3f}",
            *(number(p.genes[gene]) for gene in others),
        )
        for p in found.points
    ]
    headings = (found.gene, "rise", "score", *others)
    print_table(console, headings, rows, right=tuple(range(len(headings))))
    ends = ["beyond" if v is None else number(v) for v in (found.lower, found.upper)]
    console.print(f"90 % interval of {found.gene} (rise below 2.71): {ends[0]} to {ends[1]}")

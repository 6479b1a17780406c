"""The command `palpate compare`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.service.commands.terminal_tables import make_console, print_table
from palpate.service.report.study.comparison_page import (
    constant_rows,
    outcome_rows,
    reason_rows,
    setting_rows,
    write_comparison,
)
from palpate.service.results.study_comparison import StudyComparison, compare_studies
from palpate.storage.backends.atomic_files import write_file


def compare(
    studies: Annotated[
        list[Path], typer.Argument(metavar="STUDY STUDY...", help="Study folders, files or names.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Also write constants and scores as CSV."),
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Also write an HTML page with charts.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the results and settings of several studies.

    Shows constants with their intervals, scores, evaluations, and the settings that differ.
    Studies may still be running.
    """
    comparison = compare_studies([find_study(study) for study in studies])
    if out is not None:
        write_file(out, comparison.as_csv().encode())
    if page is not None:
        write_comparison(comparison, page)
    if as_json:
        print_json(comparison.as_dict())
        return
    print_comparison(comparison, make_console())
    for name, path in (("table", out), ("page", page)):
        if path is not None:
            typer.echo(f"{name}: {path}")


def print_comparison(comparison: StudyComparison, console: Console) -> None:
    """Print constants, scores and differing settings on a console."""
    labels = [study.label for study in comparison.studies]
    right = tuple(range(1, len(labels) + 1))
    for study in comparison.studies:
        for text in study.results.caveats:
            console.print(f"{study.label}: {text}", soft_wrap=True)
    constants = [
        (gene, *cells)
        for gene, (_, cells) in zip(comparison.genes, constant_rows(comparison), strict=True)
    ]
    print_table(console, ("constant", *labels), constants, right=right)
    for reason in reason_rows(comparison):
        console.print(f"* Not quotable: {reason}")
    outcomes = [(name, *cells) for name, cells in outcome_rows(comparison.studies)]
    print_table(console, ("measure", *labels), outcomes, right=right)
    settings = [(key, *cells) for key, cells in setting_rows(comparison)]
    if settings:
        print_table(console, ("setting", *labels), settings, right=right)
    else:
        console.print("The study files are identical except for their names.")

"""`palpate report`: what a study has found."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import typer

from service.commands.common import JsonOption, StudyArgument, find_study, print_json

Json = dict[str, Any]


def report(study: StudyArgument = None, as_json: JsonOption = False) -> None:
    """Print what was found, and write the page report.html into the study's folder."""
    from service.results import study_results

    folder = find_study(study)
    found = study_results(folder)
    if as_json:
        print_json(found)
        return
    from rich.console import Console

    print_report(found, Console(highlight=False))
    page = _write_page(folder)
    typer.echo(f"page: {page}" if page else "page: this installation writes none")


def _write_page(folder: Path) -> Path | None:
    if find_spec("service.report.html") is None:
        return None
    from service.report.html import write_report

    return Path(write_report(folder))


def print_report(found: Json, console: Any) -> None:
    """Estimates, score, what was spent, on a console."""
    from service.commands.status import score_text
    from service.progress import clock

    console.print(_estimates(found))
    if found["best"] is not None:
        console.print(f"candidate {found['best']['candidate']}: {score_text(found['score'])}")
    for label, score in found["per_label"].items():
        before = found["per_label_before"].get(label)
        start = (
            f" (undeformed: JC {before['jc']:.4f}, MHD {before['mhd_mm']:.4g} mm)" if before else ""
        )
        console.print(f"  {label}: {score_text(score)}{start}")
    counts = found["evaluations"]
    console.print(", ".join(f"{number} {what}" for what, number in counts.items()))
    console.print(f"{found['state']}" + (f": {found['stopped']}" if found["stopped"] else ""))
    total = sum(stage["total"] for stage in found["stages"].values())
    stages = ", ".join(f"{name} {clock(s['total'])}" for name, s in found["stages"].items())
    console.print(f"{clock(found['seconds'])} in all; workers {clock(total)}: {stages or 'none'}")


def _estimates(found: Json) -> Any:
    from rich.table import Table

    table = Table(title=found["study"], box=None, header_style="dim")
    for heading in ("parameter", "estimate", "target", "error", "searched"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, row in found["estimates"].items():
        unit = f" {row['unit']}".rstrip()
        error = row["relative_error"]
        table.add_row(
            name,
            "-" if row["estimate"] is None else f"{row['estimate']:.4g}{unit}",
            "-" if row["target"] is None else f"{row['target']:.4g}{unit}",
            "-" if error is None else f"{100 * error:.2g} %",
            f"{row['bounds'][0]:g} to {row['bounds'][1]:g}",
        )
    return table

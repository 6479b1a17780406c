"""`palpate status` says how far a study is, and what failed."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.commands.common import JsonOption, StudyArgument, find_study, print_json

if TYPE_CHECKING:
    from service.results import StudyResults
    from storage.records import EvaluationRecord
    from storage.task_records import Scores


def status(
    study: StudyArgument = None,
    failures: Annotated[int, typer.Option(help="How many failures to list.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Say how far a study is; it may be running meanwhile."""
    from service.results import study_results
    from service.results_json import study_json

    results = study_results(find_study(study))
    if as_json:
        print_json(study_json(results))
        return
    from rich.console import Console

    console = Console(highlight=False)
    console.print(_table(results))
    _print_failures(console, results.failures, failures)


def _table(results: "StudyResults") -> Any:
    from rich.table import Table

    from service.progress import clock

    title = f"{results.name} ({results.folder})"
    table = Table(title=title, show_header=False, box=None)
    state = results.state + (f": {results.stop_reason}" if results.stop_reason else "")
    rows = [
        ("state", state),
        ("generations", _generations_text(results)),
        ("evaluations", counts_text(results)),
    ]
    if results.best is not None and results.best.score is not None:
        candidate, score = results.best.candidate, results.best.score
        rows.append(("best", f"candidate {candidate}: {score_text(score)}"))
        genes = ", ".join(f"{name} {value:.4g}" for name, value in results.best.genes.items())
        rows.append(("", genes))
    rows.append(("time", f"{clock(results.wall_s)} in {results.sessions} runs"))
    for heading, value in rows:
        table.add_row(heading, value)
    return table


def _generations_text(results: "StudyResults") -> str:
    complete = len(results.complete_generations)
    text = f"{complete} of {results.spec.search.generations} complete"
    last = results.generations[-1]
    if last.scores is None:
        text += f"; {last.ended} of {last.evaluations} candidates of the next"
    return text


def counts_text(results: "StudyResults") -> str:
    """Write how many evaluations ended in which way."""
    from dataclasses import asdict

    return ", ".join(f"{number} {status}" for status, number in asdict(results.counts).items())


def score_text(score: "Scores") -> str:
    """Write a score for a reader."""
    return f"GSF {score['gsf']:.5g}, JC {score['jc']:.4f}, MHD {score['mhd_mm']:.4g} mm"


def _print_failures(console: Any, failures: "tuple[EvaluationRecord, ...]", most: int) -> None:
    if not failures or most <= 0:
        return
    from rich.table import Table

    table = Table(title="failures", box=None, header_style="dim")
    for heading in ("candidate", "generation", "status", "reason"):
        table.add_column(heading)
    for record in failures[-most:]:
        reason = record.reason.splitlines()[0]
        table.add_row(str(record.candidate), str(record.generation), str(record.status), reason)
    console.print(table)
    if len(failures) > most:
        console.print(f"the last {most} of {len(failures)}; see all with --failures")
    console.print(f"details: palpate show {failures[-1].candidate}")

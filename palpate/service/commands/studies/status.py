"""The command `palpate status`."""

from dataclasses import asdict
from shlex import join
from typing import Annotated

import typer
from rich.console import Console

from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import JsonOption, StudyArgument, print_json
from palpate.service.commands.terminal_tables import make_console, print_table
from palpate.service.number_formatting import number, quantities_at_door
from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_progress import clock, evaluations_text, generations_text
from palpate.storage.values import Scores
from palpate.workers.comparison.score_objective import Objective


def status(
    study: StudyArgument = None,
    failures: Annotated[int, typer.Option(help="Number of most recent failures to list.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Show a study's progress, even while it is running."""
    results = study_results(find_study(study))
    if as_json:
        print_json(study_json(results))
        return
    console = make_console()
    print_table(console, None, _rows(results), title=f"{results.name} ({results.folder})")
    _print_failures(console, results, failures)


def _rows(results: StudyResults) -> list[tuple[str, str]]:
    state = results.state + (f": {results.stop_reason}" if results.stop_reason else "")
    rows = [
        ("state", state),
        ("generations", _generations_text(results)),
        ("evaluations", counts_text(results)),
    ]
    if results.best is not None and results.best.score is not None:
        candidate, score = results.best.candidate, results.best.score
        rows.append(("best", f"candidate {candidate}: {score_text(score, results.spec.objective)}"))
        genes = quantities_at_door(results.spec.case.parameters, results.best.genes)
        rows += [("", note) for note in (results.best_note, results.squeezed_note) if note]
        texts = (f"{name} {number(q.value)} {q.unit}".rstrip() for name, q in genes.items())
        rows.append(("", ", ".join(texts)))
    runs = "1 run" if results.sessions == 1 else f"{results.sessions} runs"
    time = f"{clock(results.wall_s)} in {runs}"
    rows.append(("time", time if results.sessions else "body and target are being prepared"))
    if results.unverified_records:
        rows.append(("records", unverified_text(results.unverified_records)))
    if unchained := results.unchained_records - results.unverified_records:
        rows.append(("records", unchained_text(unchained)))
    return rows


def unverified_text(records: int) -> str:
    """Return a note on the records of a journal without a checksum."""
    return f"{records} without a checksum, written by an earlier version: they cannot be verified"


def unchained_text(records: int) -> str:
    """Return a note on the records of a journal that do not name the one before."""
    return f"{records} written before chained seals: a record taken out is not noticed"


def _generations_text(results: StudyResults) -> str:
    complete = len(results.complete_generations)
    text = generations_text(complete, results.spec.most_generations)
    last = results.generations[-1] if results.generations else None
    if last is not None and last.scores is None:
        text += f"; {last.ended} of {last.evaluations} candidates of the next"
    return text


def counts_text(results: StudyResults) -> str:
    """Return the number of evaluations by status, and of those reused, as text."""
    counts = asdict(results.counts)
    text = evaluations_text(counts, results.spec.most_evaluations)
    return f"{text}, {counts['reused']:,} from the store" if counts["reused"] else text


def score_text(score: "Scores", objective: "Objective") -> str:
    """Return a score as text."""
    return f"{objective.text(score)}, JC {score['jc']:.4f}, MHD {score['mhd_mm']:.4g} mm"


def _print_failures(console: Console, results: StudyResults, most: int) -> None:
    failures = results.failures
    if not failures or most <= 0:
        return
    rows = [
        (
            str(record.candidate),
            str(record.generation + 1),
            str(record.status),
            record.reason.splitlines()[0],
        )
        for record in failures[-most:]
    ]
    console.print("failures")
    print_table(console, ("candidate", "generation", "status", "reason"), rows, right=(0, 1))
    if len(failures) > most:
        console.print(f"the last {most} of {len(failures)}; see all with --failures")
    show = join(["palpate", "show", str(results.folder), str(failures[-1].candidate)])
    console.print(f"details: {show}")

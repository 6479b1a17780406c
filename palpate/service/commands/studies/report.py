"""The command `palpate report`."""

import typer
from rich.console import Console

from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import JsonOption, StudyArgument, print_json
from palpate.service.commands.studies.status import counts_text, score_text
from palpate.service.commands.terminal_tables import make_console, print_table
from palpate.service.number_formatting import number, share
from palpate.service.report.study.study_page import write_report
from palpate.service.results.identification import RatioEstimate
from palpate.service.results.intervals import in_words
from palpate.service.results.quotability_rule import reason_lines
from palpate.service.results.result_records import (
    DerivedEstimate,
    ParameterEstimate,
    StudyResults,
    derived_estimates,
    ratio_answer,
)
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_progress import clock

ONLY_RATIOS = (
    "Only stiffness ratios were found, because the plate distance is known but no force or "
    "stiffness is given. The values below have an arbitrary scale."
)


def report(study: StudyArgument = None, as_json: JsonOption = False) -> None:
    """Print a study's results and write report.html to its folder."""
    folder = find_study(study)
    results = study_results(folder)
    if as_json:
        print_json(study_json(results))
        return
    print_report(results, make_console())
    typer.echo(f"page: {write_report(folder)}")


def print_report(results: StudyResults, console: Console) -> None:
    """Print estimates, scores and computing time on a console."""
    for text in results.caveats:
        console.print(text, soft_wrap=True)
    if results.identifiable == "ratio":
        console.print(ONLY_RATIOS)
        _print_ratios(results, console)
    headings, rows = _estimates(results)
    right = tuple(range(1, len(headings)))
    print_table(console, headings, rows, title=results.name, right=right)
    for text in _how_well(results):
        console.print(text)
    if results.best is not None and results.best.score is not None:
        text = score_text(results.best.score, results.spec.objective)
        console.print(f"candidate {results.best.candidate}: {text}")
    for note in (results.best_note, results.squeezed_note):
        if note:
            console.print(note, soft_wrap=True)
    for label, score in results.best_scores.items():
        before = results.undeformed_scores.get(label)
        start = (
            f" (undeformed: JC {before['jc']:.4f}, MHD {before['mhd_mm']:.4g} mm)" if before else ""
        )
        console.print(f"  {label}: {score_text(score, results.spec.objective)}{start}")
    console.print(f"evaluations: {counts_text(results)}")
    console.print(results.state + (f": {results.stop_reason}" if results.stop_reason else ""))
    total_s = sum(time.total_s for time in results.stages.values())
    stages = ", ".join(f"{name} {clock(time.total_s)}" for name, time in results.stages.items())
    console.print(f"{clock(results.wall_s)} in all; workers {clock(total_s)}: {stages or 'none'}")


def _print_ratios(results: StudyResults, console: Console) -> None:
    rows, answers = [], {}
    for ratio in results.ratios:
        interval, answer = ratio_answer(results, ratio)
        estimate, *others = _numbers(ratio, "")
        shown = "-" if interval is None else _between(*interval)
        rows.append((ratio.name, estimate, shown, *others, "yes" if answer.quotable else "no"))
        answers[ratio.name] = answer
    headings = ("ratio", "estimate", "90 % interval", "target", "error", "quotable")
    print_table(console, headings, rows, right=(1, 2, 3, 4, 5))
    for text in reason_lines(answers):
        console.print(text)


def _estimates(results: StudyResults) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return headings and rows without empty columns."""
    known = results.identification
    polished = any(e.before_polish is not None for e in results.estimates.values())
    between = ("90 % interval",) * (known is not None) + ("before polish",) * polished
    rows: list[tuple[str, ...]] = []
    for name, e in results.estimates.items():
        unit = f" {e.unit}".rstrip()
        estimate, target, error = _numbers(e, unit)
        more = []
        if known is not None:
            more.append(e.interval_text or "-")
        if polished:
            more.append("-" if e.before_polish is None else f"{number(e.before_polish)}{unit}")
        searched = f"{e.lower:g} to {e.upper:g}{unit}"
        rows.append((name, estimate, *more, target, error, searched, _yes_no(e)))
    return ("parameter", "estimate", *between, "target", "error", "searched", "quotable"), rows


def _between(lower: float, upper: float) -> str:
    return f"{number(lower)} to {number(upper)}"


def _yes_no(e: ParameterEstimate) -> str:
    return "yes" if e.quotable else "no"


def _how_well(results: StudyResults) -> list[str]:
    """Return sentences on unquotable values and on how well the image determines the others."""
    texts = reason_lines(results.quotability)
    texts += [f"{e}: {e.limit_note}." for e in results.estimates.values() if e.one_sided]
    texts += [derived_text(estimate) for estimate in derived_estimates(results)]
    known = results.identification
    if known is None:
        return texts
    for name, constant in known.constants.items():
        shares = in_words(constant.errors, constant.estimate)
        if shares and results.estimates[name].interval is not None:
            texts.append(f"Standard deviation of {name} by source: {shares}.")
    if known.directions:
        texts.append(f"Least certain from the image alone: {known.directions[-1].words}.")
    return texts


def derived_text(one: DerivedEstimate) -> str:
    """Return a derived value with its interval and quotability as text."""
    interval = "" if one.interval is None else f" ({_between(*one.interval)}, 90 %)"
    return f"{one.name}: {one.value:.4g} {one.unit}{interval}. {one.answer.sentence}."


def _numbers(e: ParameterEstimate | RatioEstimate, unit: str) -> tuple[str, str, str]:
    """Return estimate, target and error as text."""
    error = e.relative_error
    return (
        "-" if e.estimate is None else f"{number(e.estimate)}{unit}",
        "-" if e.target is None else f"{number(e.target)}{unit}",
        "-" if error is None else share(error),
    )

"""`palpate status`: how far a study is, and what failed."""

from typing import Annotated, Any

import typer

from service.commands.common import JsonOption, StudyArgument, find_study, print_json

Json = dict[str, Any]


def status(
    study: StudyArgument = None,
    failures: Annotated[int, typer.Option(help="How many failures to list.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Say how far a study is; it may be running meanwhile."""
    from service.results import study_results

    found = study_results(find_study(study))
    if as_json:
        print_json(found)
        return
    from rich.console import Console

    console = Console(highlight=False)
    console.print(_table(found))
    _print_failures(console, found["failures"], failures)


def _table(found: Json) -> Any:
    from rich.table import Table

    from service.progress import clock

    config = found["config"]["search"]
    generations = found["generations"]
    complete = sum(row["complete"] for row in generations)
    table = Table(title=f"{found['study']} ({found['folder']})", show_header=False, box=None)
    rows = [("state", found["state"] + (f": {found['stopped']}" if found["stopped"] else ""))]
    now = "" if complete == len(generations) else "; {ended} of {asked} candidates of the next"
    text = f"{complete} of {config['generations']} complete" + now.format(**generations[-1])
    rows.append(("generations", text))
    counts = found["evaluations"]
    rows.append(("evaluations", ", ".join(f"{n} {what}" for what, n in counts.items())))
    best, score = found["best"], found["score"]
    if best is not None:
        rows.append(("best", f"candidate {best['candidate']}: " + score_text(score)))
        genes = ", ".join(f"{name} {value:.4g}" for name, value in best["genes"].items())
        rows.append(("", genes))
    rows.append(("time", f"{clock(found['seconds'])} in {found['sessions']} runs"))
    for heading, value in rows:
        table.add_row(heading, value)
    return table


def score_text(score: Json) -> str:
    """A score for a reader; parts that are infinite are texts already."""
    parts = {"GSF": ("gsf", ".5g", ""), "JC": ("jc", ".4f", ""), "MHD": ("mhd_mm", ".4g", " mm")}
    return ", ".join(
        f"{name} {format(float(score[key]), how)}{unit}" for name, (key, how, unit) in parts.items()
    )


def _print_failures(console: Any, failures: list[Json], most: int) -> None:
    if not failures or most <= 0:
        return
    from rich.table import Table

    table = Table(title="failures", box=None, header_style="dim")
    for heading in ("candidate", "generation", "status", "reason"):
        table.add_column(heading)
    for row in failures[-most:]:
        reason = str(row["reason"]).splitlines()[0]
        table.add_row(str(row["candidate"]), str(row["generation"]), row["status"], reason)
    console.print(table)
    if len(failures) > most:
        console.print(f"the last {most} of {len(failures)}; see all with --failures")
    console.print(f"details: palpate show {failures[-1]['candidate']}")

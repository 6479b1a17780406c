"""`palpate show` prints one candidate."""

from typing import Annotated, Any

import typer

from service.commands.common import JsonOption, StudyArgument, find_study, print_json
from storage.errors import InputError


def show(
    candidate: Annotated[str, typer.Argument(help="Number of a candidate, or best.")],
    study: StudyArgument = None,
    as_json: JsonOption = False,
) -> None:
    """Show genes, score and ending of a candidate; of a failed one, why."""
    from service.results import candidate_results
    from service.results_json import candidate_json

    if candidate != "best" and not candidate.isdecimal():
        raise InputError(f"{candidate!r} is no candidate: give its number, or best.")
    number = None if candidate == "best" else int(candidate)
    record = candidate_json(candidate_results(find_study(study), number))
    if as_json:
        print_json(record)
        return
    traceback = record.pop("traceback", "")
    for line in _lines(record):
        typer.echo(line)
    if traceback:
        typer.echo(f"\n{traceback.rstrip()}")


def _lines(record: dict[str, Any], indent: str = "") -> list[str]:
    """Write aligned ``name  value`` lines; records within are indented below their name."""
    lines = []
    for name, value in record.items():
        if isinstance(value, dict) and value:
            lines += [f"{indent}{name}", *_lines(value, indent + "  ")]
        elif value not in ("", None, {}):
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            lines.append(f"{indent}{name:<{max(1, 24 - len(indent))}}{text}")
    return lines

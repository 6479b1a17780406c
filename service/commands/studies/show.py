"""`palpate show` prints one candidate."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from palpate.service.commands.common import AllOption, JsonOption, StudyArgument, print_json
from palpate.service.commands.named_study import find_study
from palpate.service.commands.tables import echo_table
from palpate.service.quantities import Quantity, named_quantity
from palpate.service.results.as_json import candidate_json
from palpate.service.results.read import candidate_results
from palpate.storage.errors import InputError


def show(
    candidate: Annotated[str, typer.Argument(help="Candidate number, or best.")],
    study: StudyArgument = None,
    everything: AllOption = False,
    as_json: JsonOption = False,
) -> None:
    """Show a candidate's parameters, score and outcome.

    For a failed candidate, show the reason.
    """
    if candidate != "best" and not candidate.isdecimal():
        raise InputError(f"{candidate!r} is no candidate: give its number, or best.")
    number = None if candidate == "best" else int(candidate)
    record = candidate_json(candidate_results(find_study(study), number), everything=everything)
    if as_json:
        print_json(record)
        return
    traceback = record.pop("traceback", "")
    echo_table(None, list(_rows(record)))
    if traceback:
        typer.echo(f"\n{traceback.rstrip()}")


def _rows(record: Mapping[str, Any], indent: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and texts; records within are indented below their name."""
    for name, value in record.items():
        if isinstance(value, Mapping) and set(value) == {"value", "unit"}:
            yield f"{indent}{name}", str(Quantity(value["value"], value["unit"]))
        elif isinstance(value, Mapping) and value:
            yield f"{indent}{name}", ""
            if name == "seconds":
                yield from ((f"{indent}  {stage}", f"{s:.3g} s") for stage, s in value.items())
            else:
                yield from _rows(value, indent + "  ")
        elif value not in ("", None, {}):
            shown, text = named_quantity(name, value)
            yield f"{indent}{shown}", text

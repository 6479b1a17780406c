"""The command `palpate show`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import AllOption, JsonOption, print_json
from palpate.service.commands.terminal_tables import echo_table
from palpate.service.number_formatting import Quantity, named_quantity
from palpate.service.results.results_as_json import candidate_json
from palpate.service.results.results_from_journal import candidate_results
from palpate.storage.errors import InputError

BEST = "best"


def show(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="[STUDY] CANDIDATE",
            help="Study folder, file or name (default: the study in runs/ that ran last), then the "
            "candidate's number, or best.",
            show_default=False,
        ),
    ],
    everything: AllOption = False,
    as_json: JsonOption = False,
) -> None:
    """Show a candidate's parameters, score and outcome.

    For a failed candidate, show the reason.
    """
    study, number = _study_and_candidate(words)
    record = candidate_json(candidate_results(find_study(study), number), everything=everything)
    if as_json:
        print_json(record)
        return
    traceback = record.pop("traceback", "")
    echo_table(None, list(_rows(record)))
    if traceback:
        typer.echo(f"\n{traceback.rstrip()}")


def _study_and_candidate(words: Sequence[str]) -> tuple[Path | None, int | None]:
    """Return the study, if named, and the number of the candidate; None for the best.

    The candidate may come first, as it did in earlier versions.
    """
    if len(words) > 2:
        raise InputError(f"Expected a study and a candidate, found {len(words)} arguments.")
    *study, candidate = words
    if study and not _is_candidate(candidate) and _is_candidate(study[0]):
        study, candidate = [candidate], study[0]
    if not _is_candidate(candidate):
        raise InputError(f"{candidate!r} is not a candidate: give its number, or best.")
    return (Path(study[0]) if study else None), None if candidate == BEST else int(candidate)


def _is_candidate(word: str) -> bool:
    return word == BEST or word.isdecimal()


def _rows(record: Mapping[str, Any], indent: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and texts; nested records are indented below their name."""
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

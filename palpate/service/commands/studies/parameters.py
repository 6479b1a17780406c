"""The command `palpate parameters`."""

from typing import Annotated, Any

import typer

from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.service.commands.terminal_tables import echo_table
from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.law_plugins import law_named, law_names
from palpate.workers.organs.organ_plugins import catalogue_of, organ_spec

HEADINGS = ("name", "known interval", "neutral", "description")


def parameters(
    organ: Annotated[str, typer.Option(help="Name of an organ, such as cornea.")] = "breast",
    effects: Annotated[
        bool, typer.Option("--effects", help="List only effects, and explain each.")
    ] = False,
    law: Annotated[
        str | None,
        typer.Option(
            "--law",
            help="Also list the shape constants of this law of case.model.law, such as yeoh.",
            show_default=False,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List an organ's constants and effects for study files."""
    known = catalogue_of(organ)
    of_effects = {name for e in known.effects for name in e.names}
    spec = organ_spec(organ)
    vocabulary = spec.parameters
    in_studies = {p.name for p in vocabulary}
    tissues = spec.case.law_tissues
    laws = list(law_names()) if tissues else []
    if law is not None and not laws:
        raise InputError(f"A {organ} has only one law: omit --law.")
    shapes = [p for t in tissues if law is not None for p in law_named(law).constants(t)]
    named = [p for p in vocabulary if p.name not in of_effects]
    constants = [] if effects else [_parameter(p) for p in [*named, *shapes]]
    causes: list[dict[str, Any]] = [
        {
            "effect": e.name,
            "family": e.family,
            "summary": e.summary,
            "in_studies": in_studies.issuperset(e.names),
            "parameters": [_parameter(p) for p in e.parameters],
            "references": list(e.references),
        }
        for e in known.effects
    ]
    missing = [{"effect": name, "why": why} for name, why in known.not_simulated]
    if as_json:
        print_json(
            {"constants": constants, "laws": laws, "effects": causes, "not_simulated": missing}
        )
        return
    if constants:
        typer.echo("Constants, under case.constants or search.parameters:")
        echo_table(HEADINGS, [_row(p) for p in constants])
        if laws:
            typer.echo(
                f"Laws, under case.model.law: {', '.join(laws)}; --law NAME shows constants."
            )
        typer.echo()
    typer.echo("Effects, neutral unless set:")
    rows = [
        _row(p, cause["effect"], "" if cause["in_studies"] else ", diagnosis only")
        for cause in causes
        for p in cause["parameters"]
    ]
    echo_table((*HEADINGS[:-1], "effect", HEADINGS[-1]), rows)
    if effects:
        typer.echo()
        echo_table(
            ("effect", "family", "meaning"),
            [(c["effect"], c["family"], c["summary"]) for c in causes],
        )
    typer.echo("Not simulated: " + ", ".join(m["effect"] for m in missing))


def _parameter(p: Any) -> dict[str, Any]:
    low, high = (p.unit.to_door(value) for value in p.bounds)
    return {
        "name": p.door_name,
        "unit": p.unit.symbol,
        "lower": low,
        "upper": high,
        "neutral": None if p.neutral is None else p.unit.to_door(p.neutral),
        "description": p.description,
    }


def _row(p: dict[str, Any], effect: str = "", remark: str = "") -> tuple[str, ...]:
    neutral = "follows" if p["neutral"] is None else f"{p['neutral']:g} {p['unit']}".rstrip()
    interval = f"{p['lower']:.4g} to {p['upper']:.4g} {p['unit']}".rstrip()
    cells = (p["name"], interval, neutral)
    return (*cells, *([effect] if effect else []), p["description"] + remark)

"""`palpate parameters` lists what a study file may hold or search."""

from typing import Annotated, Any

import typer

from service.commands.common import JsonOption, print_json


def parameters(
    organ: Annotated[str, typer.Option(help="Whose: breast or cornea.")] = "breast",
    effects: Annotated[
        bool, typer.Option("--effects", help="Only effects, with what each one means.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List constants and effects of an organ by the names they have in a study file."""
    from workers.organs.registry import organ_named

    about = organ_named(organ)
    of_effects = {name for e in about.effects for name in e.names}
    named = [p for p in about.parameters if p.name not in of_effects]
    constants = [] if effects else [_parameter(p) for p in named]
    causes: list[dict[str, Any]] = [
        {
            "effect": e.name,
            "family": e.family,
            "summary": e.summary,
            "in_studies": e.observation is None,
            "parameters": [_parameter(p) for p in e.parameters],
            "references": list(e.references),
        }
        for e in about.effects
    ]
    missing = [{"effect": name, "why": why} for name, why in about.not_simulated]
    if as_json:
        print_json({"constants": constants, "effects": causes, "not_simulated": missing})
        return
    if constants:
        typer.echo("Constants, under case.constants or search.parameters:")
        for parameter in constants:
            typer.echo(_line(parameter))
    typer.echo("Effects, neutral unless stated:")
    for cause in causes:
        typer.echo(f"  {cause['effect']} ({cause['family']}): {cause['summary']}")
        for parameter in cause["parameters"]:
            only = "" if cause["in_studies"] else ", diagnosis only"
            typer.echo(_line(parameter, indent=4) + only)
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


def _line(p: dict[str, Any], indent: int = 2) -> str:
    neutral = "follows" if p["neutral"] is None else f"{p['neutral']:g}"
    interval = f"[{p['lower']:.3g}, {p['upper']:.3g}]"
    return f"{' ' * indent}{p['name']:<32}{interval:<16}{neutral:<9}{p['description']}"

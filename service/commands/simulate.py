"""`palpate simulate` computes one compression, outside of any search."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.common import (
    RUNS,
    JsonOption,
    StoreOption,
    constants_option,
    load_spec,
    print_json,
)

if TYPE_CHECKING:
    from storage.task_records import EvaluationResult


def simulate(
    study: Annotated[Path, typer.Argument(help="A study file, or a study's folder.")],
    constants: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A constant, such as E_fat_kpa=12."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write the deformed mesh (.vtu, .vtk, .msh), volume (.nrrd) or surface (.stl), or "
            "the whole model (.inp, .feb); see `palpate export`."
        ),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compress the body of a study once; constants not set are the case's own."""
    from service.export.suffixes import SOLVED_SUFFIXES, VOLUME_SUFFIXES, check_suffix
    from storage.stores import open_store
    from workers.tasks.evaluation import simulate_once

    check_suffix(out, SOLVED_SUFFIXES)
    spec = load_spec(study)
    case = spec.case.model_dump(mode="json")
    stated = constants_option(spec, constants or [])
    opened = open_store(store or RUNS / "store")
    result = simulate_once(case, stated, str(opened))
    volume = result.get("volume")
    if out is not None and volume is not None:
        if out.suffix.lower() in VOLUME_SUFFIXES:
            from service.export.stored import export_volume
            from storage.volumes import load_volume

            export_volume(out, load_volume(opened, volume))
        else:
            from service.export.formats import export_solved
            from service.export.solved_body import solve_body

            export_solved([out], solve_body(case, stated, str(opened), spec.name))
    if as_json:
        print_json(result)
    else:
        _print(result)


def _print(result: "EvaluationResult") -> None:
    typer.echo(result["status"] + (f": {result['reason']}" if result["reason"] else ""))
    tables: dict[str, Mapping[str, object]] = {
        "constants": result["constants"],
        "outcome": result["outcome"],
        "seconds": result["seconds"],
    }
    for title, values in tables.items():
        typer.echo(title)
        for name, value in values.items():
            text = f"{value:.6g}" if isinstance(value, float) else value
            unit = " MPa" if title == "constants" and name != "nu" else ""
            typer.echo(f"  {name:<24}{text}{unit}")

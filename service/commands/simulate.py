"""`palpate simulate`: one compression, outside of any search."""

from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.common import (
    RUNS,
    JsonOption,
    StoreOption,
    constants_option,
    load_spec,
    print_json,
)


def simulate(
    study: Annotated[Path, typer.Argument(help="A study file, or a study's folder.")],
    constants: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A constant, such as E_fat_kpa=12."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Write the deformed mesh (.vtu, .vtk, .msh) or volume (.nrrd)."),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compress the body of a study once; constants not set are the case's own."""
    from service.export import (
        MESH_SUFFIXES,
        VOLUME_SUFFIXES,
        check_suffix,
        export_stored_mesh,
        export_volume,
    )
    from storage.fields import load_field
    from storage.stores import open_store
    from storage.volumes import load_volume
    from workers.tasks import prepare_case, simulate_once

    check_suffix(out, MESH_SUFFIXES + VOLUME_SUFFIXES)
    spec = load_spec(study)
    case = spec.case.model_dump(mode="json")
    stated = constants_option(spec, constants or [])
    house = open_store(store or RUNS / "store")
    made = simulate_once(case, stated, str(house))
    if out is not None and made["status"] == "done":
        if out.suffix.lower() in VOLUME_SUFFIXES:
            export_volume(out, load_volume(house, made["volume"]))
        else:
            mesh = prepare_case(case, str(house))["mesh"]
            export_stored_mesh(out, house, mesh, load_field(house, made["digest"]))
    if as_json:
        print_json(made)
    else:
        _print(made)


def _print(made: dict[str, Any]) -> None:
    typer.echo(f"{made['status']}" + (f": {made['reason']}" if made["reason"] else ""))
    for title in ("constants", "outcome", "seconds"):
        typer.echo(title)
        for name, value in made[title].items():
            shown = f"{value:.6g}" if isinstance(value, float) else value
            unit = " MPa" if title == "constants" and name != "nu" else ""
            typer.echo(f"  {name:<24}{shown}{unit}")

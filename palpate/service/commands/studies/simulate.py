"""The command `palpate simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.service.commands.command_line import store_place
from palpate.service.commands.named_study import constants_option, load_case
from palpate.service.commands.shared_options import (
    AllOption,
    AnywayOption,
    JsonOption,
    StoreOption,
    print_findings,
    print_json,
)
from palpate.service.commands.terminal_tables import echo_table
from palpate.service.export.export_formats import export_solved
from palpate.service.export.solved_mesh_files import solve_body
from palpate.service.export.stored_files import (
    TISSUE_NAMES,
    VOLUME_SUFFIXES,
    check_suffix,
    export_volume,
    solved_suffixes,
    suffix_of,
)
from palpate.service.number_formatting import (
    Quantity,
    named_quantity,
    not_neutral,
    quantities_inside,
    quantities_json,
)
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import load_volume
from palpate.storage.values import EvaluationResult
from palpate.workers.organs.plausibility_rule import caveats_of
from palpate.workers.tasks.plausibility import check_case
from palpate.workers.tasks.study_tasks import simulate_once


def simulate(
    study: Annotated[
        Path, typer.Argument(help="Study file or study folder; name and case in a file are enough.")
    ],
    constants: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Set a constant, such as E_fat_kpa=12. Repeatable."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File for the deformed mesh (.vtu, .vtk, .msh), labels (.nrrd, .seg.nrrd, .nii, "
            ".nii.gz) or surface (.stl), or for the whole model (.inp, .feb); see `palpate export`."
        ),
    ] = None,
    everything: AllOption = False,
    anyway: AnywayOption = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compress the body of a study once.

    Other constants keep the values of the case. Only constants that are given or differ from
    their neutral values are printed.
    """
    check_suffix(out, solved_suffixes())
    named = load_case(study)
    place = store_place(store)
    findings = check_case(named.case, str(place), anyway=anyway)
    print_findings(findings)
    case = named.case.model_dump(mode="json")
    stated = constants_option(named.case, constants or [])
    opened = open_store(place)
    result = simulate_once(case, stated, str(opened))
    volume = result.get("volume")
    if out is not None and volume is not None:
        if suffix_of(out, VOLUME_SUFFIXES) in VOLUME_SUFFIXES:
            export_volume(out, load_volume(opened, volume), TISSUE_NAMES)
        else:
            export_solved([out], solve_body(case, stated, str(opened), named.name))
    vocabulary = named.case.vocabulary
    held = named.case.parameters.from_door(named.case.constants)
    kept = not_neutral(vocabulary, result["constants"], {*held, *stated})
    shown = quantities_inside(vocabulary, result["constants"] if everything else kept)
    if as_json:
        caveats = {"caveats": list(caveats_of(findings))}
        print_json(caveats | result | {"constants": quantities_json(shown)})
    else:
        _print(result, shown, len(result["constants"]) - len(shown))


def _print(result: EvaluationResult, constants: dict[str, Quantity], neutral: int) -> None:
    typer.echo(result["status"] + (f": {result['reason']}" if result["reason"] else ""))
    typer.echo("constants")
    echo_table(None, [(f"  {name}", str(quantity)) for name, quantity in constants.items()])
    if neutral:
        typer.echo(f"  {neutral} more at their neutral values: --all shows them")
    outcome = [named_quantity(name, value) for name, value in result["outcome"].items()]
    typer.echo("outcome")
    echo_table(None, [(f"  {name}", text) for name, text in outcome if text])
    typer.echo("time")
    echo_table(None, [(f"  {name}", f"{s:.3g} s") for name, s in result["seconds"].items()])

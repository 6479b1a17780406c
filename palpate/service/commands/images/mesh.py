"""The command `palpate mesh`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.command_line import store_place
from palpate.service.commands.named_study import load_spec
from palpate.service.commands.shared_options import (
    AnywayOption,
    JsonOption,
    StoreOption,
    print_findings,
    print_json,
)
from palpate.service.export import MESH_SUFFIXES, check_suffix, export_stored_mesh
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import load_mesh
from palpate.workers.body.mesh.mesh_geometry import summarise
from palpate.workers.body.mesh.mesh_hierarchy import from_arrays
from palpate.workers.organs.plausibility_rule import caveats_of
from palpate.workers.tasks.plausibility import check_case
from palpate.workers.tasks.study_tasks import case_of, prepare_case


def mesh(
    study: Annotated[Path, typer.Argument(help="Study file or study folder.")],
    nodes: Annotated[
        int | None,
        typer.Option(help="Approximate number of nodes. Default: the study's.", show_default=False),
    ] = None,
    element_size_mm: Annotated[
        float | None, typer.Option(help="Element size in mm. Default: the study's.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Also write the mesh to this .vtu, .vtk or .msh file.")
    ] = None,
    anyway: AnywayOption = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Mesh the body of a study and print the mesh properties."""
    check_suffix(out, MESH_SUFFIXES)
    case = load_spec(study).case.model_dump(mode="json")
    if nodes is not None or element_size_mm is not None:
        case["mesh"] = {"nodes": nodes, "element_size_mm": element_size_mm}
    opened = open_store(store_place(store))
    findings = check_case(case_of(case), str(opened), anyway=anyway)
    print_findings(findings)
    prepared = prepare_case(case, str(opened))
    finest = from_arrays(load_mesh(opened, prepared["mesh"])[0]).finest.mesh
    caveats = list(caveats_of(findings))
    record: dict[str, Any] = {"caveats": caveats, **prepared, "quality": summarise(finest)}
    if out is not None:
        export_stored_mesh(out, opened, prepared["mesh"])
    if as_json:
        print_json(record)
        return
    facts = prepared["facts"]
    typer.echo(
        f"{prepared['mesh']}: {facts['nodes']} nodes, {facts['tets']} tetrahedra of "
        f"{facts['element_size_mm']:.3g} mm, {facts['volume_ml']:.0f} ml, in {opened}"
    )

"""The command `palpate export`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.command_line import store_place
from palpate.service.commands.named_study import constants_option, load_spec
from palpate.service.commands.shared_options import JsonOption, StoreOption, print_json
from palpate.service.export.export_formats import export_solved, exporter_of
from palpate.service.export.solved_mesh_files import SolvedBody, solve_body
from palpate.service.export.stored_files import check_suffix, solved_suffixes
from palpate.service.results.results_from_journal import candidate_results
from palpate.service.study.study_keys import StudySpec
from palpate.storage.errors import InputError
from palpate.workers.tasks.plausibility import check_case


def export(
    study: Annotated[Path, typer.Argument(help="Study file or study folder.")],
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Files to write: .vtu .vtk .msh (mesh with stress and strain), .stl (surface), "
            ".nrrd .seg.nrrd .nii .nii.gz (labels with their names), .pvd .gif "
            "(displacement scaled from 0 to 1, for ParaView and as a moving picture), .inp "
            "(CalculiX, Abaqus), .feb (FEBio)."
        ),
    ],
    candidate: Annotated[
        str | None,
        typer.Option(help="Candidate number, or best. Default: the case's own constants."),
    ] = None,
    constants: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Set a constant, such as E_fat_kpa=12. Repeatable."
        ),
    ] = None,
    comparable: Annotated[
        bool,
        typer.Option(
            "--comparable",
            help="In every file, show the solution of the simplified model that other solvers can "
            "represent: textbook elements, and no features that they lack.",
        ),
    ] = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Export a deformed body to ParaView, CAD or another solver.

    The body is simulated again. An .inp or .feb file contains the whole model, with the plates
    replaced by the displacements of the nodes they touch; its first lines list any omissions.
    Its solution in the other solver can be compared node by node with a .vtu file written with
    --comparable.
    """
    for path in files:
        check_suffix(path, solved_suffixes(), "")
    spec = load_spec(study)
    stated, whose = _constants(study, spec, candidate, constants or [])

    check_case(spec.case)
    case = spec.case.model_dump(mode="json")
    target = spec.target.model_dump(mode="json")
    where = str(store_place(store))
    body = solve_body(case, stated, where, f"{spec.name}, {whose}", target)
    shown = export_solved(files, body, as_told=comparable)
    record = _record(shown, whose, files)
    if as_json:
        print_json(record)
        return
    typer.echo(f"{spec.name}, {whose}: {record['nodes']} nodes, {record['tets']} tetrahedra")
    for path in files:
        note = exporter_of(path).note
        typer.echo(f"  {path}" + (f": {note}" if note else ""))


def _constants(
    study: Path, spec: StudySpec, candidate: str | None, given: list[str]
) -> tuple[dict[str, float], str]:
    """Return constants by internal name, and a description of their origin."""
    if candidate is None:
        whose = "the constants given" if given else "its own constants"
        return constants_option(spec.case, given), whose
    if given:
        raise InputError(
            "--candidate and --set cannot be combined: a candidate has its own constants."
        )
    if not study.is_dir():
        raise InputError(f"{study} is a study file: --candidate needs the folder of a study.")
    if candidate != "best" and not candidate.isdecimal():
        raise InputError(f"--candidate {candidate}: expected a number, or best.")
    results = candidate_results(study, None if candidate == "best" else int(candidate))
    return spec.constants_of(results.genes), f"candidate {results.candidate}"


def _record(body: SolvedBody, whose: str, files: list[Path]) -> dict[str, Any]:
    model = body.level.model
    return {
        "title": body.title,
        "whose": whose,
        "files": [str(path) for path in files],
        "nodes": len(model.nodes),
        "tets": len(model.elements.tets),
        "outcome": body.solved.solution.outcome.as_dict(),
    }

"""Search the 24 eyes of the thesis' Table 5.2 as one batch, and compare with what is printed.

Every eye is regenerated: a section of its pachymetry under its IOP is deformed with the printed
constants, and a search that does not see them finds them again from the deformed section.

    python examples/cornea-cohort/run.py                     this machine
    python examples/cornea-cohort/run.py --scheduler tcp://HOST:8786

The same command continues an interrupted batch; each eye is a study of its own, so
`palpate status runs/cornea-cohort/05-left` works as for any other.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import typer

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import StudySpec
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.study import study_spec
from palpate.workers.organs.organ_plugins import organ_named, organ_spec
from palpate.workers.organs.organ_protocol import Scores
from palpate.workers.thesis.thesis_eyes import (
    AVERAGE_CORNEA_JC,
    AVERAGE_CORNEA_MHD_UM,
    EYE_BOUNDS,
    PRINTED_AVERAGE,
    TABLE_5_2,
    CohortEye,
    OgdenConstants,
    case_of_eye,
)

# Of each candidate that is fitted, at most.
FIT_EVALUATIONS = 40
ELEMENTS = 960


def main() -> None:
    """Run the batch, or continue it, and print the two tables."""
    wanted = arguments()
    eyes = TABLE_5_2[: wanted.eyes]
    open_store(wanted.folder / "store")  # once, before studies that begin at the same time
    studies = [(eye, spec_of(eye, wanted), wanted.folder / name_of(eye)) for eye in eyes]
    with (
        open_cluster(wanted.scheduler, wanted.workers) as cluster,
        ThreadPoolExecutor(wanted.at_once) as pool,
    ):

        def run(spec: StudySpec, folder: Path) -> None:
            study = Study(spec, folder, wanted.folder / "store")
            if not study.ended:
                study.run(Dispatcher(cluster.client))

        running = [(eye, folder, pool.submit(run, spec, folder)) for eye, spec, folder in studies]
        found = []
        for eye, folder, future in running:
            try:
                future.result()
            except InputError as error:  # such as a prestress that does not converge
                typer.echo(f"{folder.name} cannot be searched: {error}")
            else:
                found.append((eye, study_results(folder)))
                typer.echo(f"{folder.name} is done")
    typer.echo("\n".join(fitted_table(found)))
    typer.echo("\n".join(average_table(eyes)))


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("runs/cornea-cohort"))
    parser.add_argument("--scheduler", help="address of a Dask scheduler")
    parser.add_argument("--workers", type=int, help="processes of this machine")
    parser.add_argument("--at-once", type=int, default=3, help="studies in flight")
    parser.add_argument("--eyes", type=int, default=len(TABLE_5_2), help="the first so many")
    parser.add_argument("--elements", type=int, default=ELEMENTS, help="6-node triangles of an eye")
    parser.add_argument("--strategy", default="genetic+least-squares", help="or genetic alone")
    parser.add_argument("--population", type=int, default=30, help="84 in the thesis")
    parser.add_argument("--generations", type=int, default=2, help="15 in the thesis")
    parser.add_argument("--starts", type=int, default=2, help="candidates that are then fitted")
    return parser.parse_args()


def name_of(eye: CohortEye) -> str:
    """Return the name of an eye's study."""
    return f"{eye.patient:02}-{eye.side}"


def spec_of(eye: CohortEye, wanted: argparse.Namespace) -> StudySpec:
    """Return the study of an eye."""
    return study_spec(
        {
            "name": name_of(eye),
            "case": case_of_eye(eye, wanted.elements),
            "target": {"constants": eye.constants._asdict()},
            "search": {
                "parameters": EYE_BOUNDS,
                "strategy": wanted.strategy,
                "population": wanted.population,
                "generations": wanted.generations,
                "stall": None,
                "starts": wanted.starts,
                "fit_evaluations": FIT_EVALUATIONS,
            },
            "seed": 2 * eye.patient + (eye.side == "right"),
        }
    )


def fitted_table(found: list[tuple[CohortEye, StudyResults]]) -> Iterator[str]:
    """Yield what the searches have found beside what is printed."""
    yield "eye        IOP  pachymetry  G0 printed  G0 found   error      JC    MHD"
    yield "          mmHg          um         MPa       MPa       %             um"
    printed, recovered = [], []
    for eye, results in found:
        score, genes = results.best_score, None if results.best is None else results.best.genes
        if score is None or genes is None:
            yield f"{name_of(eye):<9} no candidate has a score"
            continue
        printed.append(eye.constants.shear_modulus_mpa)
        recovered.append(OgdenConstants(**genes).shear_modulus_mpa)
        error = 100 * (recovered[-1] / printed[-1] - 1)
        yield (
            f"{name_of(eye):<9} {eye.iop_mmhg:4.1f} {eye.pachymetry_um:11.0f} {printed[-1]:11.3f} "
            f"{recovered[-1]:9.3f} {error:+7.2f} {score['jc']:7.4f} {1000 * score['mhd_mm']:6.2f}"
        )
    if len(printed) > 2:
        r = np.corrcoef(printed, recovered)[0, 1]
        yield f"correlation of printed and found G0 over {len(printed)} eyes: {r:.4f}"


def average_table(eyes: tuple[CohortEye, ...]) -> Iterator[str]:
    """Yield how the average cornea of the table fits every eye, beside the thesis' figures."""
    scores = [score for eye in eyes if (score := average_score(eye)) is not None]
    jc = np.array([score["jc"] for score in scores])
    mhd_um = 1000 * np.array([score["mhd_mm"] for score in scores])
    yield f"average cornea in each of {len(eyes)} eyes ({len(eyes) - len(scores)} diverged):"
    for what, here, thesis in (
        ("JC", jc, AVERAGE_CORNEA_JC),
        ("MHD, um", mhd_um, AVERAGE_CORNEA_MHD_UM),
    ):
        yield (
            f"  {what:<8} {here.mean():7.3f} +- {here.std(ddof=1):7.3f}"
            f"   thesis, against its images: {thesis[0]:g} +- {thesis[1]:g}"
        )


def average_score(eye: CohortEye) -> Scores | None:
    """Return how alike an eye is to itself with the average constants; None if one diverges."""
    organ = organ_named("cornea")
    case = organ_spec("cornea").case.model_validate(case_of_eye(eye, ELEMENTS))
    body = organ.make_body(case.reference)
    mesh = organ.make_mesh(body, case)
    model, middle = organ.prepare(mesh), organ.landmarks(body, case)
    deformed = []
    for constants in (eye.constants, PRINTED_AVERAGE[0]):
        values = case.complete(case.parameters.from_door(constants._asdict()))
        solution = organ.solve(model, organ.problem(model, case, values, middle))
        if not solution.outcome.converged:
            return None
        deformed.append(organ.deform(body, mesh, solution.displacement_mm))
    return organ.scorer(deformed[0], organ_spec("cornea").score()).score(deformed[1]).as_dict()


if __name__ == "__main__":
    main()

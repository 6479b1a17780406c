"""Time one candidate of a cornea on one thread, and the thesis' search of 84 x 15 on two cores.

python examples/cornea-benchmark.py
python examples/cornea-benchmark.py --candidates-only
"""

import argparse
import os
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.loop import Study
from palpate.study import study_spec
from palpate.workers.organs.organ_plugins import organ_named, organ_spec
from palpate.workers.thesis.thesis_eyes import EYE_BOUNDS, TABLE_5_1, TABLE_5_2

CASE: dict[str, Any] = {"organ": "cornea", "mesh": {"elements": 960}}
REPEATS = 5


def main() -> None:
    """Print both timings and how busy the machine was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--candidates-only", action="store_true")
    wanted = parser.parse_args()
    typer.echo(f"load of the machine before: {os.getloadavg()[0]:.1f}")
    typer.echo("\n".join(candidate_lines()))
    if not wanted.candidates_only:
        typer.echo(search_line(wanted.workers))


def candidate_lines() -> list[str]:
    """Return the seconds of a candidate: prestress and jet, and those with derivatives."""
    organ = organ_named("cornea")
    case = organ_spec("cornea").case.model_validate(CASE)
    body = organ.make_body(case.reference)
    mesh = organ.make_mesh(body, case)
    model, middle = organ.prepare(mesh), organ.landmarks(body, case)
    triangles = organ.facts(body, mesh)["triangles"]
    constants = [eye.target for eye in TABLE_5_1] + [eye.constants for eye in TABLE_5_2]
    solve_s = []
    for one in constants:
        values = case.complete(case.parameters.from_door(one._asdict()))
        problem = organ.problem(model, case, values, middle)
        solve = partial(organ.solve, model, problem)
        solve()
        solve_s.append(min(_seconds(solve) for _ in range(REPEATS)))
    return [
        f"one candidate, {triangles} triangles, prestress and jet, {len(constants)} sets of "
        f"constants: median {np.median(solve_s):.3f} s, slowest {max(solve_s):.3f} s"
    ]


def search_line(workers: int) -> str:
    """Return how long the thesis' search of X1 takes."""
    spec = study_spec(
        {
            "name": "benchmark",
            "case": CASE,
            "target": {"constants": TABLE_5_1[0].target._asdict(), "mesh": {"elements": 2880}},
            "search": {
                "parameters": EYE_BOUNDS,
                "population": 84,
                "generations": 15,
                "stall": None,
            },
        }
    )
    with tempfile.TemporaryDirectory() as folder, open_cluster(None, workers) as cluster:
        study = Study(spec, Path(folder) / "study", Path(folder) / "store")
        wall_s = _seconds(lambda: study.run(Dispatcher(cluster.client)))
        results = study_results(Path(folder) / "study")
    score = results.best_score or {}
    return (
        f"search of {spec.most_evaluations} candidates on {workers} workers: {wall_s:.0f} s, "
        f"JC {score.get('jc', np.nan):.4f}"
    )


def _seconds(call: Any) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()

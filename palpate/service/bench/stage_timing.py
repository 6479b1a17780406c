"""Benchmarks of the time and memory of each stage, each in a separate process.

A stage first runs on a tiny body, so that loading compiled kernels is not timed, then at the
requested size; the solver reports the fastest of three runs. Some stages are reported as ratios:
derivatives to their solution, the time per unknown to the time on the next smaller mesh, two
concurrent solutions to a single one. Peak memory is measured for the process; it includes about
0.25 GB for Python and the libraries.
"""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import TaskError
from palpate.storage.store import open_store
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.organs.organ_plugins import catalogue_of, organ_named, organ_spec
from palpate.workers.tasks.task_store import BodyStore

BREAST, SPEC = organ_named("breast"), organ_spec("breast")
STAGES = ("phantom", "mesh", "prepare", "solve", "tangent", "tangents", "warp", "score")
REPEATED = {"solve": 3, "tangent": 3, "tangents": 3}
# Ten parameters with all kinds of forces: loads, plates, stiffness, fibres.
TEN_OF = ("gravity_change", "plate_force", "plate_tilt", "stiffness_gradient", "fibre_rotation")
# The single tangent is by a constant: a load along a free axis only moves the body rigidly.
STEP_MPA = 1e-5
TINY_SPACING_MM, TINY_NODES = 2.0, 1000
# A target and a candidate near the optimum, where a search spends most of its time.
TRUE_MPA = {"E_fat": 0.010, "E_glandular": 0.040}
OTHER_MPA = {"E_fat": 0.0102, "E_glandular": 0.041}
TRIVIAL_TASKS = 200


@dataclass(frozen=True)
class Row:
    """One measurement; `peak_mb` is None if other processes do the work.

    ``ratio`` is `seconds` relative to the measurement named in `over`.
    """

    stage: str
    size: str
    nodes: int | None
    voxels: int | None
    seconds: float
    peak_mb: float | None
    ratio: float | None = None
    over: str = ""


def measure(nodes: Sequence[int], spacings_mm: Sequence[float], store: Path) -> Iterator[Row]:
    """Measure every stage at every size, then the overhead of the scheduler.

    Parameters
    ----------
    nodes : sequence of int
        Mesh sizes; mesh, prepare and the solver run at each, on the first spacing.
    spacings_mm : sequence of float
        Voxel sizes; phantom, warp and score run at each, with the first mesh size.
    store : Path
        Folder in which stages keep their results for later ones.

    Raises
    ------
    TaskError
        If a stage fails.
    """
    for spacing in spacings_mm:
        yield _in_process("phantom", spacing, nodes[0], store)
    for stage in ("mesh", "prepare"):
        for count in nodes:
            yield _in_process(stage, spacings_mm[0], count, store)
    yield from _solver(nodes, spacings_mm[0], store)
    for stage in ("warp", "score"):
        for spacing in spacings_mm:
            yield _in_process(stage, spacing, nodes[0], store)
    yield scheduler_overhead()


def _solver(nodes: Sequence[int], spacing_mm: float, store: Path) -> Iterator[Row]:
    """Measure one solution, two at once, and the derivatives of one, at every size."""
    before: Row | None = None
    for count in nodes:
        alone = _in_process("solve", spacing_mm, count, store)
        yield alone
        each = per_unknown(alone, before)
        yield each
        before = each
        both = _in_processes("solve", spacing_mm, count, store, 2)
        slower = max(both, key=lambda row: row.seconds)
        yield _compared(slower, alone, "two at once", "one alone")
        for stage, name in (("tangent", "one tangent"), ("tangents", "ten tangents")):
            yield _compared(_in_process(stage, spacing_mm, count, store), alone, name, "a solution")


def _compared(row: Row, other: Row, stage: str, over: str) -> Row:
    return replace(row, stage=stage, ratio=row.seconds / other.seconds, over=over)


def per_unknown(solve: Row, before: Row | None) -> Row:
    """Return the time per unknown (three per node), and its ratio to the time on mesh `before`."""
    assert solve.nodes is not None
    seconds = solve.seconds / (3 * solve.nodes)
    row = replace(solve, stage="unknown", seconds=seconds, peak_mb=None)
    if before is None:
        return row
    return replace(row, ratio=seconds / before.seconds, over=f"{before.nodes} nodes")


def scheduler_overhead(tasks: int = TRIVIAL_TASKS) -> Row:
    """Return the time per trivial task, on one worker."""
    with open_cluster(workers=1) as cluster:
        dispatcher = Dispatcher(cluster.client)
        list(dispatcher.run(nothing, ((i, (i,)) for i in range(10))))
        begun = time.perf_counter()
        ended = sum(1 for _ in dispatcher.run(nothing, ((i, (i,)) for i in range(tasks))))
        seconds = (time.perf_counter() - begun) / ended
    return Row("scheduler", "one task", None, None, seconds, None)


def nothing(number: int) -> dict[str, int]:
    """Do nothing."""
    return {"number": number}


def _in_process(stage: str, spacing_mm: float, nodes: int, store: Path) -> Row:
    return _in_processes(stage, spacing_mm, nodes, store, 1)[0]


def _in_processes(stage: str, spacing_mm: float, nodes: int, store: Path, count: int) -> list[Row]:
    """Run the same stage in `count` processes that start at the same time."""
    command = [
        sys.executable,
        "-m",
        "palpate.service.bench.stage_timing",
        stage,
        str(spacing_mm),
        str(nodes),
        str(store),
    ]
    with ThreadPoolExecutor(count) as threads:
        done = list(threads.map(_finished, [command] * count))
    for process in done:
        if process.returncode:
            lines = process.stderr.strip().splitlines()[-3:]
            message = "\n".join(lines) or f"exit code {process.returncode}"
            where = f"{nodes} nodes and {spacing_mm} mm"
            raise TaskError(f"The stage {stage} at {where} failed: {message}")
    return [Row(**json.loads(process.stdout.splitlines()[-1])) for process in done]


def _finished(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


class Bench:
    """The stages for a breast with a given voxel and mesh size.

    Parameters
    ----------
    spacing_mm, nodes
        Voxel size in mm, and number of nodes.
    store : Path
        Folder with the inputs of a stage, which are created if missing.
    """

    def __init__(self, spacing_mm: float, nodes: int, store: Path) -> None:
        self.case = validated(
            SPEC.case,
            {
                "reference": {"phantom": {"spacing_mm": spacing_mm}},
                "mesh": {"nodes": nodes},
                "load": {"force_n": 100.0},
            },
            "The size",
        )
        self.bodies = BodyStore(open_store(store), BREAST)
        self.size = f"{spacing_mm:g} mm, {nodes} nodes requested"
        self.voxels: int | None = None
        self.nodes: int | None = None

    def run(self, stage: str) -> Row:
        """Prepare the inputs of the stage, then time it."""
        work = getattr(self, f"_{stage}")()
        seconds = float("inf")
        for _ in range(REPEATED.get(stage, 1)):
            begun = time.perf_counter()
            work()
            seconds = min(seconds, time.perf_counter() - begun)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        per_mb = 1024**2 if sys.platform == "darwin" else 1024
        return Row(stage, self.size, self.nodes, self.voxels, seconds, peak / per_mb)

    def _body(self) -> Any:
        self.body = self.bodies.bring_body(self.case.reference)
        volume = self.bodies.body(self.body)
        self.voxels = volume.values.size
        return volume

    def _hierarchy(self) -> Any:
        self._body()
        name, facts = self.bodies.bring_mesh(self.body, self.case)
        self.mesh = name
        self.nodes = facts["nodes"]
        return self.bodies.mesh(name)

    def _phantom(self) -> Any:

        def work() -> None:
            self.voxels = BREAST.make_body(self.case.reference).values.size

        return work

    def _mesh(self) -> Any:
        volume = self._body()

        def work() -> None:
            made = BREAST.make_mesh(volume, self.case)
            self.nodes = len(made.finest.mesh.nodes)

        return work

    def _prepare(self) -> Any:
        hierarchy = self._hierarchy()
        return lambda: prepare(hierarchy)

    def _simulation(self, constants: Mapping[str, float]) -> Any:
        model = self.bodies.model(self.mesh)
        values = self.case.complete(constants)
        body = self.bodies.landmarks(self.body, self.case)
        return lambda: BREAST.solve(model, BREAST.problem(model, self.case, values, body))

    def _solve(self) -> Any:
        self._hierarchy()
        return self._simulation(TRUE_MPA)

    def _problem(self, constants: Mapping[str, float]) -> Problem:
        self._hierarchy()
        values, body = self.case.complete(constants), self.bodies.landmarks(self.body, self.case)
        return BREAST.problem(self.bodies.model(self.mesh), self.case, values, body)

    def _tangents(self) -> Any:
        problem = self._problem(TRUE_MPA)
        model = self.bodies.model(self.mesh)
        frame = frame_of(model.finest.nodes)
        at = equilibrium(model, problem)
        effects = map(catalogue_of(BREAST.name).named, TEN_OF)
        changes = [c for effect in effects for c in effect.changes(problem, frame)][:10]
        assert len(changes) == 10
        return lambda: tangents(at, changes)

    def _tangent(self) -> Any:
        problem = self._problem(TRUE_MPA)
        at = equilibrium(self.bodies.model(self.mesh), problem)
        stiffer = self._problem({**TRUE_MPA, "E_fat": TRUE_MPA["E_fat"] + STEP_MPA})
        change = Change(stiffer, problem, STEP_MPA)
        return lambda: tangents(at, [change])

    def _deformation(self, constants: Mapping[str, float]) -> Any:
        mesh = self._hierarchy()
        moved = self._simulation(constants)().displacement_mm
        volume = self.bodies.body(self.body)
        return lambda: BREAST.deform(volume, mesh, np.ascontiguousarray(moved))

    def _warp(self) -> Any:
        return self._deformation(TRUE_MPA)

    def _score(self) -> Any:
        target = self._deformation(TRUE_MPA)()
        candidate = self._deformation(OTHER_MPA)()
        against = BREAST.scorer(target, SPEC.score())
        against.score(candidate)  # the target's distance map is computed once for all candidates
        return lambda: against.score(candidate)


def main(stage: str, spacing_mm: str, nodes: str, store: str) -> None:
    """Run one stage in this process and print its row."""
    Bench(TINY_SPACING_MM, TINY_NODES, Path(store)).run(stage)
    row = Bench(float(spacing_mm), int(nodes), Path(store)).run(stage)
    sys.stdout.write(json.dumps(asdict(row)) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

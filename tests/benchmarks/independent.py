"""Run time of CalculiX compared with our solver: same mesh, same physics, one thread.

    python -m tests.benchmarks.independent [NODES ...]

A breast of fat and gland, neo-Hookean, is pressed from 100 to 75 mm. We solve it with plates
and from rest. CalculiX gets the final positions of the nodes that touch the plates, and so
has no contact to find: its time is a lower bound. Both solve plain linear tetrahedra in
alternation, and the fastest of three runs counts. CalculiX's time includes its start and
reading the deck; ours excludes the preparation of the mesh, which a search does once for all
candidates.
"""

import json
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# One thread for every library; read when it is loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"
ROOMS = Path(__file__).parents[1]
sys.path.append(str(ROOMS / "reference"))

import numpy as np  # noqa: E402

from palpate.storage.values import Tissue  # noqa: E402
from palpate.workers.body.mesh.mesh_hierarchy import MeshLevel  # noqa: E402
from palpate.workers.mechanics.fem.body_equilibrium import solve  # noqa: E402
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem, Solution  # noqa: E402
from palpate.workers.mechanics.fem.discretisation import Model, prepare  # noqa: E402
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, Wall  # noqa: E402
from palpate.workers.organs.breast.breast_keys import BreastCase  # noqa: E402
from palpate.workers.organs.breast.breast_organ import ORGAN  # noqa: E402
from tests.reference.calculix import Answer, Body, Held, Material, available  # noqa: E402
from tests.reference.calculix import solve as calculix  # noqa: E402

FAT, GLAND = Constants(0.010), Constants(0.040)
LOWER_MM, UPPER_MM = -37.5, 37.5
REPEATS = 3
WARM_NODES = 1000  # a first, untimed solve loads the compiled kernels
# Half of the load at once and its own tolerances: the fastest settings found for CalculiX.
FASTEST: dict[str, Any] = {"first_increment": 0.5, "tight": False}


@dataclass(frozen=True)
class Row:
    """One size: run time of each solver, and the difference between their solutions."""

    nodes: int
    tets: int
    our_seconds: float
    our_default_seconds: float
    ccx_seconds: float
    ratio: float
    mean_difference_mm: float
    max_difference_mm: float


class Case:
    """The breast at one mesh size."""

    def __init__(self, nodes: int) -> None:
        asked = {"reference": {"phantom": {"spacing_mm": 1.0}}, "mesh": {"nodes": nodes}}
        case = BreastCase.model_validate(asked)
        hierarchy = ORGAN.make_mesh(ORGAN.make_body(case.reference), case)
        self.level: MeshLevel = hierarchy.finest
        self.model: Model = prepare(hierarchy)

    def ours(self, *, plain: bool = True) -> Solution:
        """Solve the body under plates; `plain` elements lock, the default ones do not."""
        problem = Problem(
            {Tissue.FAT: FAT, Tissue.GLANDULAR: GLAND},
            DistanceControl(LOWER_MM, UPPER_MM),
            wall=Wall(held=(True, False, True)),
            plain_elements=plain,
        )
        solution = solve(self.model, problem)
        if not solution.outcome.converged:
            raise RuntimeError(f"Our solver stopped: {solution.outcome.reason}")
        return solution

    def body(self, moved_mm: np.ndarray) -> Body:
        """Return the model for CalculiX, with contact nodes moved to their final positions."""
        mesh, wall = self.level.mesh, self.level.wall
        y = mesh.nodes[:, 1] + moved_mm[:, 1]
        free = np.unique(self.level.surface)
        touching = free[(y[free] < LOWER_MM) | (y[free] > UPPER_MM)]
        tissue = self.level.fractions.argmax(axis=1)
        materials = tuple(
            Material(np.flatnonzero(tissue == t), c.mu_mpa, c.kappa_mpa)
            for t, c in ((Tissue.FAT, FAT), (Tissue.GLANDULAR, GLAND))
        )
        held = (Held(wall, 0), Held(wall, 2), Held(touching, 1, moved_mm[touching, 1]))
        return Body(mesh, materials, held)


def ccx_seconds(nodes: int, repeats: int = 1) -> float:
    """Return the fastest run time of CalculiX at about the given number of nodes."""
    case = Case(nodes)
    body = case.body(case.ours().displacement_mm)
    return min(calculix(body, **FASTEST).seconds for _ in range(repeats))


def compare(nodes: int, repeats: int = REPEATS) -> Row:
    """Run both solvers in turn, at about the given number of nodes.

    Raises
    ------
    RuntimeError
        If a solver does not converge.
    """
    Case(WARM_NODES).ours()
    case = Case(nodes)
    ours, default, theirs = [], [], []
    for _ in range(repeats):
        begun = time.perf_counter()
        solution = case.ours()
        ours.append(time.perf_counter() - begun)
        begun = time.perf_counter()
        case.ours(plain=False)
        default.append(time.perf_counter() - begun)
        answer: Answer = calculix(case.body(solution.displacement_mm), **FASTEST)
        theirs.append(answer.seconds)
    away = np.linalg.norm(solution.displacement_mm - answer.displacement_mm, axis=1)
    mesh = case.level.mesh
    return Row(
        nodes=len(mesh.nodes),
        tets=len(mesh.tets),
        our_seconds=min(ours),
        our_default_seconds=min(default),
        ccx_seconds=min(theirs),
        ratio=min(theirs) / min(ours),
        mean_difference_mm=float(away.mean()),
        max_difference_mm=float(away.max()),
    )


def main(*sizes: str) -> None:
    """Print a table, then the same data as one line of JSON."""
    if not available():
        raise SystemExit("CalculiX is not installed (Debian: apt install calculix-ccx).")
    rows = [compare(int(size)) for size in sizes or ("5000",)]
    write = sys.stdout.write
    write(" nodes    tets  ours s  default s   ccx s  ccx/ours  mean mm   max mm\n")
    for r in rows:
        write(
            f"{r.nodes:6d} {r.tets:7d} {r.our_seconds:7.2f} {r.our_default_seconds:10.2f} "
            f"{r.ccx_seconds:7.2f} {r.ratio:9.1f} {r.mean_difference_mm:8.1e} "
            f"{r.max_difference_mm:8.1e}\n"
        )
    write(json.dumps([asdict(r) for r in rows]) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Measures whether breasts with stiff glands in soft fat find an equilibrium, and at what cost.

Phantoms are pressed with 100 N, E 5 kPa in fat and a multiple of it in glands. Not a test: 27
bodies of 20000 nodes take some five minutes of one core.

    python -m tests.benchmarks.contrast --nodes 20000 --seeds 1-9 --ratios 4,16,40
"""

import argparse
import time

from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_problem import extent_of

FORCE_N, SPACING_MM, E_FAT_MPA = 100.0, 1.0, 0.005


def measure(nodes: int, seed: int, ratios: list[float]) -> None:
    """Print a line for each ratio of E in glands to E in fat."""
    phantom = {"spacing_mm": SPACING_MM, "seed": seed}
    given = {
        "reference": {"phantom": phantom},
        "mesh": {"nodes": nodes},
        "load": {"force_n": FORCE_N},
    }
    case = validated(BreastCase, given)
    body = ORGAN.make_body(case.reference)
    model = prepare(ORGAN.make_mesh(body, case))
    for ratio in ratios:
        moduli = case.complete({"E_fat": E_FAT_MPA, "E_glandular": ratio * E_FAT_MPA})
        problem = ORGAN.problem(model, case, moduli, extent_of(body))
        begun = time.process_time()
        found = equilibrium(model, problem)
        seconds = time.process_time() - begun
        outcome = found.solution.outcome
        print(  # noqa: T201
            f"{nodes:6d} nodes, phantom {seed}, ratio {ratio:4g}: "
            f"{'converged' if outcome.converged else 'FAILED'}, "
            f"Newton steps {'+'.join(map(str, outcome.newton_iterations))}, {seconds:6.1f} CPU s, "
            f"least J {outcome.min_j:.2f}{', barrier' if found.levels[-1].barrier else ''}"
            f" {outcome.reason}",
            flush=True,
        )


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=20_000)
    parser.add_argument("--seeds", default="1-9", help="the first and the last")
    parser.add_argument("--ratios", default="4,16,40")
    given = parser.parse_args()
    first, last = (int(v) for v in given.seeds.split("-"))
    for seed in range(first, last + 1):
        measure(given.nodes, seed, [float(v) for v in given.ratios.split(",")])


if __name__ == "__main__":
    main()

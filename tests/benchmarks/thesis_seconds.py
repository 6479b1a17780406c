"""Recording of the run times of the thesis' parts, for the estimates shipped with Palpate.

    python -m tests.benchmarks.thesis_seconds STORE FOLDER            from a complete store
    python -m tests.benchmarks.thesis_seconds STORE FOLDER --one      one new part of each kind

The second form runs, at the reduced scale and without a cluster, one part of each kind and
one search for each target.
"""

import argparse
import json
from pathlib import Path

from palpate.service.thesis.remaining_time import RECORDED, kind_of, recorded_here
from palpate.service.thesis.thesis_experiments import (
    EXPERIMENTS,
    POLISHED,
    ThesisRequest,
    phases_of,
    run_search,
)
from palpate.workers.tasks.thesis_tasks import Press, bend_bar
from palpate.workers.thesis.phantom_compression import Scale

# In the middle of the ten; a denser phantom has a larger adaptive mesh.
PHANTOM = 6


def run_one_of_each(request: ThesisRequest, searches: bool) -> None:
    """Run one part of each kind, for a phantom in the middle."""
    ran: set[str] = set()
    for experiment in EXPERIMENTS:
        phases = phases_of(experiment, str(request.store), request.scale)
        for phase in phases:
            for one in phase.requests:
                middle = getattr(one, "phantom", PHANTOM) == PHANTOM or one.kind.startswith("vary")
                first_law = not isinstance(one, Press) or one.law == "neo-Hookean"
                if one.kind in ran or not middle or not first_law:
                    continue
                if one.kind == "compare":  # it needs all bars
                    for bend in phases[0].requests:
                        bend_bar(bend)  # type: ignore[arg-type]
                print(one.label, phase.task(one), flush=True)  # noqa: T201
                ran.add(one.kind)
    if searches:
        from palpate.service.cluster.dask_cluster import open_cluster
        from palpate.service.cluster.task_dispatch import Dispatcher

        with open_cluster(None, 1) as cluster:
            for run in request.searches:
                if kind_of(run) not in ran:
                    ran.add(kind_of(run))
                    run_search(run, request.store, Dispatcher(cluster.client), lambda *_: None)
                    print(kind_of(run), flush=True)  # noqa: T201


def main() -> None:
    """Record the times of a store, or run one part of each kind first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scale", default="reduced")
    parser.add_argument("--one", action="store_true")
    parser.add_argument("--searches", action="store_true")
    options = parser.parse_args()
    scale: Scale = options.scale
    request = ThesisRequest(EXPERIMENTS, scale, options.store, options.folder, POLISHED)
    if options.one:
        run_one_of_each(request, options.searches)
    found = recorded_here(request)
    known = json.loads(RECORDED.read_text(encoding="utf-8"))
    seconds = {kind: round(value, 2) for kind, value in sorted(found.seconds.items())}
    known["machine"] = found.machine
    known["seconds"][scale] = seconds
    RECORDED.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

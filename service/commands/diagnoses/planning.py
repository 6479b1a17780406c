"""Plans on a cluster, for the commands that end with one."""

import time
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from palpate.service.cluster.worker_range import Workers
    from palpate.workers.diagnosis.schema.plan import PlanSummary
    from palpate.workers.tasks.planning import LoadRecord, PlanRequest


def planned(
    request: "PlanRequest",
    workers: "Workers | None",
    scheduler: str | None,
) -> "PlanSummary":
    """Return the plan, from the store if it is there."""
    from rich.console import Console

    from palpate.service.diagnosis.planning import run_plan
    from palpate.service.study.session import session
    from palpate.workers.tasks.planning import stored_plan

    done = stored_plan(request)
    if done is not None:
        typer.echo("The store holds this plan: nothing to compute.", err=True)
        return done
    with session(scheduler, workers) as opened:
        progress = _Progress(Console(stderr=True, highlight=False))
        return run_plan(request, opened.dispatcher, progress)


class _Progress:
    """Prints a line for each load on standard error."""

    def __init__(self, console: "Console") -> None:
        self.console, self.begun = console, time.monotonic()

    def __call__(self, done: int, of: int, record: "LoadRecord | None") -> None:
        from palpate.service.study.observers.progress import clock

        text = f"simulating {of} loads and what every effect would do to them"
        if record is not None:
            ending = "" if record.simulated else ", which does not converge"
            text = f"{done} of {of} loads: {record.name}{ending}"
        spent = clock(time.monotonic() - self.begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)

"""Plans on a cluster, for the commands that end with one."""

import time
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from workers.foresee import PlanRequest

Json = dict[str, Any]


def planned(
    request: "PlanRequest", workers: int | None, scheduler: str | None, requests: list[int]
) -> Json | None:
    """The plan; None if somebody asked to stop."""
    from rich.console import Console

    from service.cluster import open_cluster
    from service.diagnosis.foresee import run_plan
    from service.dispatch import Dispatcher
    from service.errors import Interrupted
    from workers.foresee import stored_plan

    done = stored_plan(request)
    if done is not None:
        typer.echo("The store holds this plan: nothing to compute.", err=True)
        return done
    try:
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            return run_plan(request, dispatcher, _Teller(Console(stderr=True, highlight=False)))
    except (Interrupted, KeyboardInterrupt):
        return None


class _Teller:
    """A line for each load on standard error."""

    def __init__(self, console: "Console") -> None:
        self.console, self.begun = console, time.monotonic()

    def __call__(self, done: int, of: int, told: Json) -> None:
        from service.progress import clock

        text = f"simulating {of} loads and what every effect would do to them"
        if told:
            ending = "" if told["simulated"] else ", which does not converge"
            text = f"{done} of {of} loads: {told['name']}{ending}"
        spent = clock(time.monotonic() - self.begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)

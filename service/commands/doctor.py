"""`palpate doctor`: whether everything is ready."""

from typing import Annotated, Any

import typer

from service.commands.common import RUNS, JsonOption, StoreOption, print_json


def doctor(
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Examine this cluster, tcp://HOST:8786."),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check versions, workers, store and kernels; exit code 2 if something would spoil a run."""
    from service.cluster import open_cluster
    from service.doctor import examine

    place = str((store or RUNS / "store").absolute())
    with open_cluster(scheduler, None if scheduler else 1) as cluster:
        found = examine(cluster, place)
    if as_json:
        print_json(found)
    else:
        _print(found)
    if found["problems"]:
        raise typer.Exit(2)


def _print(found: dict[str, Any]) -> None:
    for role, told in found["processes"].items():
        memory = told["memory_bytes"] / 1024**3
        typer.echo(
            f"{role}: palpate {told['versions']['palpate']} ({told['code']}) on {told['host']}, "
            f"Python {told['versions']['python']}, {told['cores']} cores, {memory:.1f} GiB"
        )
        if role == "client":
            for name, folder in told["packages"].items():
                typer.echo(f"  {name:<10}{folder}")
    if found["store"]:
        free = found["store"]["free_bytes"] / 1024**3
        typer.echo(f"store: {found['store']['root']}, {free:.0f} GiB free")
    if found["dashboard"]:
        typer.echo(f"dashboard: {found['dashboard']}")
    for problem in found["problems"]:
        typer.echo(f"problem: {problem}", err=True)
    typer.echo("not ready" if found["problems"] else "all is well")

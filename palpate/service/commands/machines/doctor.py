"""The command `palpate doctor`."""

from typing import TYPE_CHECKING, Annotated

import typer

from palpate.service.commands.command_line import cluster_options, store_place
from palpate.service.commands.shared_options import JsonOption, StoreOption, print_json
from palpate.service.library_settings import unusable_settings

if TYPE_CHECKING:
    from palpate.service.cluster.doctor_checks import Examination, StoreFacts


def doctor(
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Check the Dask cluster at this address, such as tcp://HOST:8786. "
            "Default: $PALPATE_SCHEDULER.",
            show_default=False,
        ),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check that everything is ready for a run.

    Checks versions, workers, store and kernels. The exit code is 2 if there is a problem.
    """
    scheduler, _ = cluster_options(scheduler, None)
    place = str(store_place(store))
    unusable = list(unusable_settings())
    if unusable:
        if as_json:
            print_json({"problems": unusable})
        else:
            _print_problems(unusable)
        raise typer.Exit(2)
    examination = _examined(scheduler, place)
    if as_json:
        print_json(examination.as_dict())
    else:
        _print(examination)
    if examination.problems:
        raise typer.Exit(2)


def _examined(scheduler: str | None, place: str) -> "Examination":
    # These import Dask.
    from palpate.service.cluster.dask_cluster import open_cluster
    from palpate.service.cluster.doctor_checks import examine

    with open_cluster(scheduler, None if scheduler else 1) as cluster:
        return examine(cluster, place)


def _store_words(facts: "StoreFacts") -> str:
    tried = "written, read and listed"
    if facts["free_bytes"] is not None:
        return f"{facts['root']}, {tried}, {facts['free_bytes'] / 1024**3:.0f} GiB free"
    honoured = "honoured" if facts["takes_once"] else "IGNORED by the server"
    return f"{facts['root']}, {tried}; conditional put (If-None-Match) {honoured}"


def _print(examination: "Examination") -> None:
    for role, facts in examination.processes.items():
        memory = facts["memory_bytes"] / 1024**3
        typer.echo(
            f"{role}: palpate {facts['versions']['palpate']} ({facts['code']}) on "
            f"{facts['host']}, Python {facts['versions']['python']}, {facts['cores']} cores, "
            f"{memory:.1f} GiB"
        )
        if role == "client":
            for name, folder in facts["packages"].items():
                typer.echo(f"  {name:<10}{folder}")
        for words in facts["plugins"]:
            typer.echo(f"  plug-in   {words}")
    if examination.store is not None:
        typer.echo(f"store: {_store_words(examination.store)}")
    if examination.dashboard:
        typer.echo(f"dashboard: {examination.dashboard}")
    _print_problems(examination.problems)


def _print_problems(problems: list[str]) -> None:
    for problem in problems:
        typer.echo(f"problem: {problem}", err=True)
    typer.echo("not ready" if problems else "all is well")

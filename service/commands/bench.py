"""`palpate bench` measures how long each stage takes on this machine."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from service.commands.common import JsonOption, print_json
from storage.errors import InputError

if TYPE_CHECKING:
    from service.bench import Row

Number = TypeVar("Number", int, float)


def bench(
    nodes: Annotated[str, typer.Option(help="Mesh sizes.")] = "5000,20000",
    spacing: Annotated[str, typer.Option(help="Voxel sizes in mm.")] = "1,0.5",
    service: Annotated[
        bool, typer.Option("--service", help="Instead: overhead, memory and idle workers.")
    ] = False,
    evaluations: Annotated[
        int, typer.Option(min=200, help="Trivial ones, with --service; a multiple of 200.")
    ] = 20_000,
    as_json: JsonOption = False,
) -> None:
    """Time phantom, mesh, solver, warp and score, and their memory.

    The thesis' own size is --nodes 90000 --spacing 0.2. Against CalculiX, an
    independent solver: python -m tests.benchmarks.independent in the sources.
    With --service everything around the simulations, in some ten minutes.
    """
    import tempfile

    if service:
        bench_service(evaluations, as_json=as_json)
        return

    from service.bench import measure

    counts = numbers(nodes, "--nodes", int)
    sizes = numbers(spacing, "--spacing", float)
    rows = []
    with tempfile.TemporaryDirectory(prefix="palpate-bench-") as folder:
        for row in measure(counts, sizes, Path(folder)):
            rows.append(asdict(row))
            if not as_json:
                typer.echo(line(row))
    if as_json:
        print_json(rows)


def bench_service(evaluations: int, *, as_json: bool) -> None:
    """Measure what is not simulation, and print each figure when it is known."""
    from service.service_bench import all_rows

    rows = []
    for row in all_rows(evaluations):
        rows.append(row)
        if not as_json:
            typer.echo("  ".join(f"{name} {value}" for name, value in row.items()))
    if as_json:
        print_json(rows)


def line(row: "Row") -> str:
    """Write one row of the table."""
    size = row.size if row.nodes is None else f"{row.size} ({row.nodes})"
    small = row.seconds < 1e-3
    time = f"{row.seconds * 1e6:10.2f} us" if small else f"{row.seconds:10.4f} s "
    peak = " " * 13 if row.peak_mb is None else f"{row.peak_mb:10.0f} MB"
    ratio = "" if row.ratio is None else f"{row.ratio:8.2f} x {row.over}"
    return f"{row.stage:<13}{size:<36}{time}{peak}{ratio}".rstrip()


def numbers(text: str, option: str, kind: type[Number]) -> list[Number]:
    """Parse ``1,0.5`` as positive numbers.

    Raises
    ------
    InputError
        If it does not read so.
    """
    try:
        values = [kind(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or any(not 0 < number < float("inf") for number in values):
        raise InputError(f"{option} {text}: expected positive numbers such as 5000,20000.")
    return values

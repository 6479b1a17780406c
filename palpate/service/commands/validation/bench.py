"""The command `palpate bench`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from palpate.service.bench.diagnosis_timing import WORKERS, PhaseTimes, measure_diagnosis, projected
from palpate.service.bench.service_overhead import all_rows
from palpate.service.bench.stage_timing import Row, measure
from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS

Number = TypeVar("Number", int, float)


def bench(
    nodes: Annotated[
        str, typer.Option(help="Numbers of mesh nodes, separated by commas.")
    ] = "5000,20000",
    spacing: Annotated[str, typer.Option(help="Voxel sizes in mm, separated by commas.")] = "1,0.5",
    service: Annotated[
        bool, typer.Option("--service", help="Measure overhead, memory and idle workers instead.")
    ] = False,
    evaluations: Annotated[
        int,
        typer.Option(
            min=200, help="Number of trivial evaluations for --service; a multiple of 200."
        ),
    ] = 20_000,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            metavar="CASE", help="Time the tasks of this diagnosis instead.", show_default=False
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the time and memory of each stage of a simulation.

    The stages are phantom, mesh, solver, warp and score. The thesis used --nodes 90000
    --spacing 0.2. --service measures everything but the simulations and takes about ten minutes.
    --diagnosis times the tasks of a diagnosis and projects the total time for more workers. To
    compare with CalculiX, an independent solver, run python -m tests.benchmarks.independent in the
    source tree.
    """
    import tempfile

    if service and diagnosis is not None:
        raise InputError("--service and --diagnosis cannot be combined: give one of them.")
    if service:
        bench_service(evaluations, as_json=as_json)
        return
    if diagnosis is not None:
        bench_diagnosis(diagnosis, as_json=as_json)
        return

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
    """Measure everything but simulations, and print each figure once it is known."""
    rows = []
    for row in all_rows(evaluations):
        rows.append(row)
        if not as_json:
            typer.echo("  ".join(f"{name} {value}" for name, value in row.items()))
    if as_json:
        print_json(rows)


def bench_diagnosis(source: Path, *, as_json: bool) -> None:
    """Measure the tasks of a diagnosis, and print each phase when it ends."""
    import tempfile

    def tell(phase: PhaseTimes) -> None:
        if not as_json:
            tasks = f"{len(phase.seconds):4d} tasks"
            longest = f"the longest {max(phase.seconds):.1f} s"
            typer.echo(f"{phase.phase:<13}{tasks}{sum(phase.seconds):8.1f} s, {longest}")

    with tempfile.TemporaryDirectory(prefix="palpate-bench-") as folder:
        phases = measure_diagnosis(source, Path(folder), SETTINGS.mesh.nodes, tell)
    alone = projected(phases, 1)
    rows = [(n, projected(phases, n)) for n in WORKERS]
    if as_json:
        each = [{"workers": n, "seconds": s, "ratio": alone / s} for n, s in rows]
        print_json({"phases": [asdict(phase) for phase in phases], "projected": each})
        return
    for n, seconds in rows:
        typer.echo(f"on {n:2d} workers{seconds:21.1f} s, {alone / seconds:.1f} times as fast")


def line(row: Row) -> str:
    """Return one row of the table as text."""
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
        If it is malformed.
    """
    try:
        values = [kind(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or any(not 0 < number < float("inf") for number in values):
        raise InputError(f"{option} {text}: expected positive numbers such as 5000,20000.")
    return values

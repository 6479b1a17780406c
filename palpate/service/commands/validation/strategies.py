"""The command `palpate strategies`."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from palpate.service.bench.strategy_benchmark import (
    STRATEGIES,
    Bench,
    Reached,
    measure_strategies,
    write_chart,
)
from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.service.number_formatting import share
from palpate.storage.errors import InputError


def strategies(
    folder: Annotated[Path, typer.Option("--folder", help="Folder for the studies.")] = Path(
        "runs/strategies"
    ),
    only: Annotated[
        str, typer.Option(help="Strategies to compare, separated by commas.")
    ] = "least-squares,genetic+least-squares,genetic,cma",
    targets: Annotated[int, typer.Option(min=1, help="Number of targets.")] = 10,
    nodes: Annotated[int, typer.Option(min=100, help="Approximate number of mesh nodes.")] = 2000,
    spacing_mm: Annotated[float, typer.Option("--spacing", help="Voxel size in mm.")] = 1.0,
    target_nodes: Annotated[
        int | None,
        typer.Option(
            min=100,
            help="Approximate number of mesh nodes for the targets. Default: the same as --nodes.",
        ),
    ] = None,
    workers: Annotated[
        int,
        typer.Option(min=1, help="Number of studies to run at the same time, each on one core."),
    ] = 1,
    as_json: JsonOption = False,
) -> None:
    """Compare the cost of search strategies on the same targets.

    On one core, least-squares takes seconds per target and genetic some minutes. Finished studies
    are reused; interrupted ones continue. FOLDER/strategies.svg plots score and errors against
    evaluations and seconds.
    """
    chosen = only.split(",")
    if unknown := sorted(set(chosen) - set(STRATEGIES)):
        raise InputError(f"--only {unknown[0]}: expected one or more of {', '.join(STRATEGIES)}.")
    rows = []
    bench = Bench(targets, nodes, spacing_mm, target_nodes)
    for row in measure_strategies(folder, chosen, bench, workers):
        rows.append(row)
        typer.echo(line(row), err=as_json)
    chart = folder / "strategies.svg"
    write_chart(rows, chart)
    if as_json:
        print_json([asdict(row) for row in rows])
        return
    for text in summary(rows):
        typer.echo(text)
    typer.echo(f"chart: {chart}")


def line(row: Reached) -> str:
    """Return the result of one study as a line of text."""
    near = "never" if row.until_near is None else f"{row.until_near:4d} evaluations"
    errors = ", ".join(f"{gene} {100 * e:+.2f} %" for gene, e in row.errors.items())
    return (
        f"target {row.target}, {row.strategy}: within 2 % after: {near}; {row.evaluations} in all, "
        f"{row.core_s:.0f} core-s, GSF {row.gsf:.3f}; {errors}"
    )


def summary(rows: Sequence[Reached]) -> list[str]:
    """Return a Markdown table with a line for each strategy."""
    head = (
        "| strategy | targets | evaluations until both moduli are within 2 % (median, maximum) | "
        "core-s until then (median) | evaluations in all (median) | GSF (median) | "
        "mean error E_fat, E_gl, eta_fat, eta_gl | in the 90 % interval |"
    )
    lines = [head, "|" + "---|" * 8]
    for strategy in dict.fromkeys(row.strategy for row in rows):
        own = [row for row in rows if row.strategy == strategy]
        near = [np.inf if r.until_near is None else r.until_near for r in own]
        seconds = [np.inf if r.core_s_until_near is None else r.core_s_until_near for r in own]
        genes = ("E_fat_kpa", "E_glandular_kpa", "eta_fat_kpa", "eta_glandular_kpa")
        errors = [100 * np.mean([abs(r.errors[g]) for r in own]) for g in genes]
        held = [w for r in own for w in r.within.values()]
        lines.append(
            f"| {strategy} | {len(own)} | {np.median(near):.3g}, {max(near):.3g} | "
            f"{np.median(seconds):.3g} | {np.median([r.evaluations for r in own]):.4g} | "
            f"{np.median([r.gsf for r in own]):.2f} | "
            f"{', '.join(share(float(e) / 100) for e in errors)} | {sum(held)} of {len(held)} |"
        )
    return lines

"""The command `palpate evaluate`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.command_line import RUNS, cluster_options, interruptible, stated_store
from palpate.service.commands.shared_options import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    WorkersOption,
    print_findings,
    print_json,
)
from palpate.storage.errors import InputError


def evaluate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="[TABLE] STUDY",
            help="Table of candidates (.csv or .parquet, one column per constant, such as "
            "E_fat_kpa), then a study file or folder. With --design, only the study.",
            show_default=False,
        ),
    ],
    design: Annotated[
        str | None,
        typer.Option(
            help="Fill the searched intervals evenly instead of reading a table: sobol, halton or "
            "latin-hypercube.",
            show_default=False,
        ),
    ] = None,
    n: Annotated[int, typer.Option("--n", min=1, help="Number of points of the design.")] = 64,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the design.")] = 1,
    out: Annotated[
        Path | None, typer.Option(help="Write all rows to this .csv or .parquet file.")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|URL",
            help="Store for volumes and evaluations, accessible to all workers: a folder, or "
            "s3://, gs:// or az://BUCKET/PREFIX. Default: $PALPATE_STORE, else the store of "
            "the study.",
            show_default=False,
        ),
    ] = None,
    anyway: AnywayOption = False,
    as_json: JsonOption = False,
) -> None:
    """Evaluate a table or a design of candidates for a study.

    Constants without a column keep the values of the case. Stored evaluations are
    reused: press Ctrl-C to stop at any time, and the same command continues. Rows of candidates
    that do not converge give the reason.
    """
    with interruptible():  # before the imports, which take a while
        scheduler, processes = cluster_options(scheduler, workers)
        from palpate.service.commands.named_study import load_spec
        from palpate.service.commands.terminal_tables import progress_console
        from palpate.service.simulation.candidate_batch import (
            BatchProgress,
            evaluate_batch,
            plan_batch,
        )
        from palpate.service.simulation.candidate_tables import (
            check_table_suffix,
            design_columns,
            read_table,
        )
        from palpate.service.study.study_session import session

        table, study = _table_and_study(paths, design)
        if out is not None:
            check_table_suffix(out)
        spec = load_spec(study)
        rows: Any
        if design is not None:
            rows = design_columns(spec.search.space, design, n, seed)
        else:
            assert table is not None
            rows = read_table(table)
        folder = study if study.is_dir() else RUNS / spec.name
        plan = plan_batch(spec, rows, folder, stated_store(store))
        print_findings(plan.check(anyway=anyway, elsewhere=scheduler is not None))
        progress = BatchProgress(progress_console())
        with session(scheduler, processes) as opened, progress:
            evaluations = evaluate_batch(plan, opened.dispatcher, observers=[progress])
    if out is not None:
        evaluations.save(out)
    if as_json:
        print_json(list(evaluations.rows()))
        return
    _print(evaluations, out)


def _table_and_study(paths: list[Path], design: str | None) -> tuple[Path | None, Path]:
    """Return the table, if any, and the study, given in either order."""
    if design is not None:
        if len(paths) != 1:
            raise InputError("--design replaces the table: give only the study.")
        return None, paths[0]
    if len(paths) != 2:
        raise InputError("Give a table and a study, or a study and --design sobol --n 256.")
    first, second = paths
    is_swapped = second.suffix.lower() in (".csv", ".parquet")
    return (second, first) if is_swapped else (first, second)


def _print(found: Any, out: Path | None) -> None:
    from palpate.service.commands.terminal_tables import echo_table
    from palpate.service.number_formatting import number

    counts = ", ".join(f"{count} {status}" for status, count in found.counts.items())
    reused = int(found["reused"].sum())
    typer.echo(f"{len(found)} candidates: {counts}" + (f"; {reused} reused" if reused else ""))
    best = found.best
    if best is not None:
        values = [(name, number(value)) for name, value in best.genes.items()]
        scores = [(name, number(best.score[name])) for name in ("gsf", "jc", "mhd_mm")]
        typer.echo(f"best: row {best.candidate + 1}")
        echo_table(None, [(f"  {name}", text) for name, text in [*values, *scores]])
    if out is not None:
        typer.echo(f"table: {out}")
    else:
        typer.echo("--out FILE.csv writes all rows.")

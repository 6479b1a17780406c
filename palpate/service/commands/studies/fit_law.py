"""The command `palpate fit-law`."""

from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.service.commands.terminal_tables import echo_table
from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.law_fit import (
    LawFit,
    StressTable,
    equally_good,
    read_tables,
)
from palpate.workers.mechanics.materials.law_fit import fit_law as fit_one
from palpate.workers.mechanics.materials.law_fit_range import TableSlack, moduli_of_parts, slack_of
from palpate.workers.mechanics.materials.law_plugins import law_named, law_names


def fit_law(
    tables: Annotated[
        list[Path],
        typer.Argument(
            metavar="TABLE...",
            help="CSV files with the columns stretch, strain, strain_percent or shear; stress_kpa, "
            "stress_mpa or stress_pa (nominal); and mode, if not uniaxial.",
        ),
    ],
    law: Annotated[str, typer.Option("--law", help="Name of a law, or all.")] = "all",
    nu: Annotated[
        float, typer.Option("--nu", help="Poisson's ratio for the file that uses the constants.")
    ] = 0.49,
    as_json: JsonOption = False,
) -> None:
    """Fit material laws to stress-stretch tables of one material.

    All tables have the same weight. The specimen is assumed to be incompressible. Laws are ranked
    by AICc, and the lines for a study file or a bench experiment are printed for the best one.
    """
    if not 0 < nu < 0.5:
        raise InputError(f"--nu must be above 0 and below 0.5, found {nu:g}.")
    read = [(path, table) for path in tables for table in read_tables(path)]
    sources = [
        f"{path.name} ({table.mode}, {len(table.deformation)} points)" for path, table in read
    ]
    fits: list[LawFit] = []
    failed: dict[str, str] = {}
    for name in law_names() if law == "all" else (law,):
        try:
            fit = fit_one(law_named(name), [table for _, table in read])
            if law == "all" and not isfinite(fit.aicc):
                raise InputError("The tables have too few points to compare laws.")
            fits.append(fit)
        except InputError as error:
            if law != "all":
                raise
            failed[name] = str(error)
    if not fits:
        raise InputError("No law can be fitted. " + " ".join(dict.fromkeys(failed.values())))
    fits.sort(key=lambda one: one.aicc)
    best = equally_good(fits)
    measured = [table for _, table in read]
    slack = list(slack_of([law_named(name) for name in law_names()], measured))
    ranges = {fit.plugin.name: _range_kpa(fit, measured, slack, nu) for fit in best}
    if as_json:
        print_json(
            {
                "tables": sources,
                "fits": [_record(fit, nu) for fit in fits],
                "equally_good": [fit.plugin.name for fit in best],
                "E_range_kpa": ranges,
                "slack": [_slack_record(one, nu) for one in slack],
                "failed": failed,
            }
        )
        return
    _print_fits(fits, best, sources)
    _print_range(best[0], ranges[best[0].plugin.name], slack, nu)
    _print_lines(best[0], nu)
    for name, reason in failed.items():
        typer.echo(f"{name}: not fitted. {reason}")


def _young_kpa(one: LawFit, nu: float) -> float:
    return 2 * (1 + nu) * one.shear_modulus_mpa * 1e3


def _range_kpa(
    one: LawFit, tables: list[StressTable], slack: list[TableSlack], nu: float
) -> tuple[float, float] | None:
    """Return the least and the largest E over parts of the range and without slack starts."""
    shear_mpa = [*(moduli_of_parts(one, tables) or ()), *(s.fit.shear_modulus_mpa for s in slack)]
    if not shear_mpa:
        return None
    low, high = (2 * (1 + nu) * end * 1e3 for end in (min(shear_mpa), max(shear_mpa)))
    return low, high


def _slack_record(slack: TableSlack, nu: float) -> dict[str, Any]:
    return {
        "table": slack.table + 1,
        "offset_strain": slack.offset,
        "law": slack.fit.plugin.name,
        "E_kpa": _young_kpa(slack.fit, nu),
        "relative_error": slack.fit.fit.error,
    }


def _print_range(
    chosen: LawFit, ends_kpa: tuple[float, float] | None, slack: list[TableSlack], nu: float
) -> None:
    """Print E with its interval over the range of the tables, and which tables are slack."""
    law = chosen.plugin.name
    told = f"E of {law} is {_young_kpa(chosen, nu):.4g} kPa over all points"
    if ends_kpa is None:
        typer.echo(f"{told}; these are too few to tell how E depends on the range of strain.")
    else:
        typer.echo(f"{told}, {ends_kpa[0]:.4g} to {ends_kpa[1]:.4g} kPa over parts of the range.")
    for one in slack:
        counted, E_kpa = one.fit.plugin.name, _young_kpa(one.fit, nu)
        typer.echo(f"Table {one.table + 1} looks slack up to {100 * one.offset:.2g} % of strain.")
        typer.echo(f"Counted from there, {counted} has E {E_kpa:.4g} kPa and an error of")
        from_zero = 100 * chosen.fit.errors[one.table]
        typer.echo(
            f"{100 * one.fit.fit.error:.2g} %; from 0, {law} has an error of {from_zero:.2g} %."
        )
        typer.echo("If the specimen was slack, leave these rows out and count strain from there;")
        typer.echo("if its fibres straighten there, the table is right as it is.")
    typer.echo()


def _record(one: LawFit, nu: float) -> dict[str, Any]:
    return {
        "law": one.plugin.name,
        "shear_modulus_kpa": one.shear_modulus_mpa * 1e3,
        "E_kpa": _young_kpa(one, nu),
        "nu": nu,
        "constants": one.constants,
        "relative_error": one.fit.error,
        "relative_errors": list(one.fit.errors),
        "aicc": one.aicc if isfinite(one.aicc) else None,
    }


def _print_fits(fits: list[LawFit], best: list[LawFit], sources: list[str]) -> None:
    for number, source in enumerate(sources, 1):
        typer.echo(f"table {number}: {source}")
    typer.echo()
    errors = [f"error {number}" for number in range(1, len(sources) + 1)]
    rows = [
        (
            law_fit.plugin.name,
            f"{law_fit.shear_modulus_mpa * 1e3:.4g} kPa",
            *(f"{100 * error:.2g} %" for error in law_fit.fit.errors),
            "0.0" if law_fit is fits[0] else f"{law_fit.aicc - fits[0].aicc:.1f}",
            ", ".join(f"{name} {value:.4g}" for name, value in law_fit.constants.items()),
        )
        for law_fit in fits
    ]
    echo_table(("law", "mu0", *errors, "AICc - best", "shape constants"), rows)
    typer.echo()
    if len(fits) > 1:
        names = ", ".join(law_fit.plugin.name for law_fit in best)
        told = "fits best" if len(best) == 1 else "fit about equally well (AICc within 2)"
        typer.echo(f"{names} {told}.")
        typer.echo("AICc assumes independent deviations, but neighbouring points on a curve")
        typer.echo("are correlated, so small differences mean little.")
        typer.echo()


def _print_lines(chosen: LawFit, nu: float) -> None:
    """Print the lines for a study or an experiment."""
    constants = chosen.constants
    law, E = chosen.plugin.name, f"{_young_kpa(chosen, nu):.5g}"
    shape = "".join(f", {name}_fat: {value:.5g}" for name, value in constants.items())
    typer.echo(f"For a breast study, with nu = {nu:g} (glandular tissue likewise):")
    typer.echo("case:")
    typer.echo(f"  model: {{law: {{fat: {law}}}}}")
    typer.echo(f"  constants: {{nu: {nu:g}, E_fat_kpa: {E}{shape}}}")
    listed = ", ".join(f"{name}: {value:.5g}" for name, value in constants.items())
    typer.echo(f"For a material of a bench experiment (E about {E} kPa):")
    typer.echo(f"  law: {law}")
    if listed:
        typer.echo(f"  constants: {{{listed}}}")

"""Defines the command `palpate`.

Exit codes: 0 done; 1 a fault of ours, with its traceback; 2 something that the
user can put right, said in one message; 130 interrupted, and how to go on.
"""

from collections.abc import Sequence
from typing import Annotated

import typer

from service.commands import (
    bench,
    blind,
    diagnose,
    doctor,
    export,
    import_,
    import_case,
    mesh,
    new,
    parameters,
    phantom,
    plan,
    report,
    run,
    show,
    simulate,
    status,
)
from storage.errors import PalpateError

app = typer.Typer(
    name="palpate",
    help="The stiffness of living tissue from images, by finite elements and search.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(requested: bool) -> None:
    if requested:
        from service.versions import palpate_version

        typer.echo(f"palpate {palpate_version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Say it.")
    ] = False,
) -> None:
    pass


app.command("new")(new.new)
app.command("run")(run.run)
app.command("status")(status.status)
app.command("show")(show.show)
app.command("report")(report.report)
app.command("diagnose")(diagnose.diagnose)
app.command("plan")(plan.plan)
app.add_typer(blind.app, name="blind")
app.command("import")(import_.import_image)
app.command("import-case")(import_case.import_case)
app.command("phantom")(phantom.phantom)
app.command("mesh")(mesh.mesh)
app.command("parameters")(parameters.parameters)
app.command("simulate")(simulate.simulate)
app.command("export")(export.export)
app.command("doctor")(doctor.doctor)
app.command("bench")(bench.bench)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; its exit code."""
    try:
        app(arguments)
    except PalpateError as error:
        typer.echo(f"Error: {error}", err=True)
        return 2
    except SystemExit as ended:  # typer leaves so, with 2 for a wrong option and 130 for Ctrl-C
        return int(ended.code or 0)
    return 0

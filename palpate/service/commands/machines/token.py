"""The commands of `palpate token`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from palpate.service.commands.command_line import RUNS
from palpate.service.commands.shared_options import JsonOption, print_json
from palpate.service.server.jobs.home_and_tokens import ServiceHome, Tokens

app = typer.Typer(no_args_is_help=True, help="Manage the access tokens of a service.")

HomeOption = Annotated[Path, typer.Option("--home", help="Folder of the service.")]
NameArgument = Annotated[str, typer.Argument(help="Name of the token's owner.")]


@app.command("new")
def new(
    name: NameArgument,
    home: HomeOption = RUNS,
    role: Annotated[
        Literal["read", "submit", "admin"],
        typer.Option(
            help="What the token allows: read; submit, which includes changing one's own jobs; or "
            "admin, which includes changing the jobs of others."
        ),
    ] = "submit",
    as_json: JsonOption = False,
) -> None:
    """Create a token and show it once.

    A running service accepts it immediately.
    """
    token = _tokens(home, make=True).new(name, role)
    if as_json:
        print_json({"name": name, "role": role, "token": token})
    else:
        typer.echo(token)


@app.command("list")
def list_(home: HomeOption = RUNS, as_json: JsonOption = False) -> None:
    """List the names and roles of all tokens."""
    roles = _tokens(home).roles
    if as_json:
        print_json({"tokens": list(roles), "roles": roles})
    else:
        lines = [f"{name}  {role}" for name, role in roles.items()]
        typer.echo("\n".join(lines) or "There are no tokens.")


@app.command("remove")
def remove(name: NameArgument, home: HomeOption = RUNS) -> None:
    """Revoke a token, effective immediately."""
    _tokens(home).remove(name)


def _tokens(home: Path, *, make: bool = False) -> Tokens:
    root = home.expanduser().absolute()
    service = ServiceHome(root, root / "store")
    if make:
        service.make()
    return Tokens(service.tokens)

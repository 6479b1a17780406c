"""A command group that imports the module of a command on demand."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

_PACKAGE = "palpate.service.commands"


@dataclass(frozen=True, slots=True)
class LazyCommand:
    """A command, or a group of commands, that has not been imported.

    Parameters
    ----------
    place : str
        Module below `service.commands` and name of the function or `typer.Typer` in it,
        as in ``studies.run:run``.
    summary : str
        First sentence of its help.
    """

    place: str
    summary: str

    def load(self, name: str) -> Any:
        """Import the module and return the Click command."""
        module, _, attribute = self.place.partition(":")
        found = getattr(import_module(f"{_PACKAGE}.{module}"), attribute)
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=name)
        else:
            app.command(name)(found)
        return typer.main.get_group(app).commands[name]


def lazy_group(commands: Mapping[str, LazyCommand]) -> type[TyperGroup]:
    """Return a group that lists commands by summary and loads only the one used."""

    class LazyGroup(TyperGroup):
        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            """Replace the placeholder with the command; also used by shell completion."""
            name, listed, rest = super().resolve_command(ctx, args)
            return name, commands[name].load(name) if name else listed, rest

    return LazyGroup


def list_commands(app: typer.Typer, commands: Mapping[str, LazyCommand]) -> None:
    """Add the names and summaries of commands to an application."""
    for name, command in commands.items():
        app.command(name, help=command.summary)(_listed)


def _listed() -> None:
    """Do nothing; a placeholder for a command in the list, never run."""

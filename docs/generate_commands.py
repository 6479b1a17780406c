"""The reference of the commands: what each `--help` prints."""

from collections.abc import Iterator
from typing import Any

WIDTH = 96
HEAD = """# Commands

The output of `palpate COMMAND --help` for every command. Every command that reads prints JSON with
`--json`. Exit codes: 0 success; 1 an error in Palpate itself, with a traceback; 2 something that
you can correct, explained in one message; 130 interrupted.
"""


def commands_page() -> str:
    """Return the help of every command as Markdown."""
    import typer

    from palpate.service.cli import app

    lines = [HEAD]
    for path, command in _commands(typer.main.get_command(app), ()):
        lines += [f"## {' '.join(path)}", "", "```", _help(path, command), "```", ""]
    return "\n".join(lines)


def _commands(group: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        here = (*path, name)
        if hasattr(command, "commands"):
            yield from _commands(command, here)
        else:
            yield here, command


def _help(path: tuple[str, ...], command: Any) -> str:
    context = command.make_context(
        " ".join(("palpate", *path)), ["--help"], resilient_parsing=True, max_content_width=WIDTH
    )
    context.terminal_width = WIDTH
    return str(command.get_help(context)).rstrip()

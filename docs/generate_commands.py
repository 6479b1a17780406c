"""The reference of the commands: what each `--help` prints."""

from collections.abc import Iterator, Mapping
from typing import Any

WIDTH = 96
HEAD = """# Commands

The output of `palpate COMMAND --help` for every command. Every command that reads prints JSON with
`--json`. Exit codes: 0 success; 1 an error in Palpate itself, with a traceback; 2 something that
you can correct, explained in one message; 130 interrupted.
"""


def commands_page() -> str:
    """Return the help of every command as Markdown."""
    from palpate.service.cli import COMMANDS

    lines = [HEAD]
    commands = {name: command.load(name) for name, command in COMMANDS.items()}
    for path, command in _commands(commands, ()):
        lines += [f"## {' '.join(path)}", "", "```", _help(path, command), "```", ""]
    return "\n".join(lines)


def _commands(
    commands: Mapping[str, Any], path: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in commands.items():
        here = (*path, name)
        if hasattr(command, "commands"):
            yield from _commands(command.commands, here)
        else:
            yield here, command


def _help(path: tuple[str, ...], command: Any) -> str:
    context = command.make_context(
        " ".join(("palpate", *path)), ["--help"], resilient_parsing=True, max_content_width=WIDTH
    )
    context.terminal_width = WIDTH
    return str(command.get_help(context)).rstrip()

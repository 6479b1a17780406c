"""Writes the pages that are made from the code: the commands, and the names of `palpate`.

MkDocs calls `on_files` and `on_page_markdown` (mkdocs.yml, `hooks`).
"""

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

WIDTH = 96
COMMANDS_HEAD = """# Commands

What `palpate COMMAND --help` prints, for every command. Every command that reads prints JSON with
`--json`. Exit codes: 0 done; 1 a fault of Palpate, with its traceback; 2 something to put right,
said in one message; 130 interrupted.
"""


def on_files(files: Any, config: Any) -> Any:
    """Add commands.md, which no file holds."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "commands.md", content=commands_page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """End python.md with the public names and their docstrings."""
    if page.file.src_uri == "python.md":
        return markdown + "\n" + "\n".join(_names())
    return markdown


def commands_page() -> str:
    """Return the help of every command as Markdown."""
    import typer

    from service.cli import app

    lines = [COMMANDS_HEAD]
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


def _names() -> Iterator[str]:
    import palpate

    for name in sorted(palpate.__all__, key=str.lower):
        if name.startswith("_"):
            continue
        value = getattr(palpate, name)
        yield f"### {name}\n"
        yield _block(name, value)
        if inspect.isclass(value) and value.__module__.startswith("palpate"):
            for member, function in inspect.getmembers(value, _is_public):
                if member.startswith("_") or member not in vars(value):
                    continue
                yield f"#### {name}.{member}\n"
                yield _block(member, function)


def _block(name: str, value: Any) -> str:
    return f"```\n{_signature(name, value)}\n\n{inspect.getdoc(value) or ''}\n```\n"


def _is_public(value: Any) -> bool:
    return inspect.isfunction(value) or inspect.ismethod(value) or isinstance(value, property)


def _signature(name: str, value: Any) -> str:
    if isinstance(value, property):
        return name
    try:
        return f"{name}{inspect.signature(value)}"
    except (TypeError, ValueError):
        return name

"""Detection of scripts that start worker processes without a main guard.

Python starts each worker by importing the script again. Without the guard, every worker would
open another cluster.
"""

import ast
import sys
from pathlib import Path
from types import FrameType, ModuleType

from palpate.storage.errors import InputError


def check_main_guard() -> None:
    """Raise an error if the unguarded top level of a script starts workers.

    Raises
    ------
    InputError
        If it does; the message gives the two lines to add to the script.
    """
    main = sys.modules.get("__main__")
    script = _script_of(main)
    line = None if main is None else _running_line(main)
    text = "" if script is None else _text(script)
    if script is not None and line is not None and text and is_unguarded(text, line):
        raise InputError(missing_guard(script, line))


def missing_guard(script: Path, line: int) -> str:
    """Return the message for a script without a main guard."""
    return (
        f"{script}, line {line}, starts worker processes outside of a main guard, and each worker "
        "imports this script again. Move the code that runs into a function, and end the script "
        'with the two lines\n\n    if __name__ == "__main__":\n        main()\n'
    )


def is_unguarded(text: str, line: int) -> bool:
    """Return True if the top level of a script is certain to run on import, too.

    Parameters
    ----------
    text : str
        Text of the script.
    line : int
        The line of its top level that is being executed, from 1.
    """
    try:
        body = ast.parse(text).body
    except SyntaxError:
        return False
    return not any(_asks_for_main(statement) for statement in body if statement.lineno <= line)


def lacks_guard() -> bool:
    """Return True if the running program is a script that never checks ``__name__``."""
    script = _script_of(sys.modules.get("__main__"))
    text = "" if script is None else _text(script)
    return bool(text) and "__name__" not in text and "parent_process" not in text


def _asks_for_main(statement: ast.stmt) -> bool:
    names = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
    attributes = {node.attr for node in ast.walk(statement) if isinstance(node, ast.Attribute)}
    is_definition = isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
    asks = {"__name__", "parent_process", "current_process"} & (names | attributes)
    return bool(asks) and not is_definition


def _script_of(main: ModuleType | None) -> Path | None:
    """Return the file that workers import; None in a notebook, a console or with -c."""
    file = getattr(main, "__file__", None)
    return Path(file) if file and Path(file).name != "__main__.py" else None


def _running_line(main: ModuleType) -> int | None:
    """Return the line of the main module that is being executed; None in other threads."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        if frame.f_globals is vars(main) and frame.f_code.co_name == "<module>":
            return frame.f_lineno
        frame = frame.f_back
    return None


def _text(script: Path) -> str:
    try:
        return script.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""

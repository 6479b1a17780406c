"""Start of worker processes: forked with their imports done, and refused without a main guard.

Python starts each worker by importing the running script again. Without the guard, every worker
would open another cluster.

A spawned worker spends one and a half seconds on imports before its first task. The fork
server of Python's multiprocessing imports once, in a separate process, while the command still
reads its input; forking a copy takes a tenth of a second, even when it replaces a worker that died.
The fork server ends with the command, whether or not a worker was started.
"""

import ast
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, resource_tracker, set_forkserver_preload
from pathlib import Path
from types import FrameType, ModuleType

from palpate.storage.errors import InputError
from palpate.workers import WORKER_ENVIRONMENT


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
    text = "" if script is None else _script_text(script)
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
    text = "" if script is None else _script_text(script)
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


def _script_text(script: Path) -> str:
    try:
        return script.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


METHOD = "distributed.worker.multiprocessing-method"
SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def forked_workers(scheduler: str | None, *modules: str) -> Iterator[None]:
    """Start importing modules; workers of clusters opened within this context have them loaded.

    Only on Linux: elsewhere system libraries do not survive a fork, and workers are spawned.

    Parameters
    ----------
    scheduler : str or None
        Address of a cluster used instead of this machine; nothing is imported then.
    *modules : str
        Dotted names. Importing them must not start a thread.
    """
    if scheduler is not None or sys.platform != "linux":
        yield
        return
    _start_fork_server(modules)
    import dask  # slow; meanwhile the fork server is already importing

    with dask.config.set({METHOD: "forkserver"}):
        yield


def _start_fork_server(modules: tuple[str, ...]) -> None:
    set_forkserver_preload(list(modules))
    os.environ.update(WORKER_ENVIRONMENT)  # read when NumPy is loaded, and at process start
    with unheard_interrupts(), _safe_path():
        forkserver.ensure_running()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Prevent modules in the user's folder from shadowing installed ones."""
    is_set = SAFE_PATH in os.environ
    os.environ.setdefault(SAFE_PATH, "1")
    try:
        yield
    finally:
        if not is_set:
            del os.environ[SAFE_PATH]


@contextmanager
def unheard_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes started within this context; it reaches this process afterwards.

    A terminal sends SIGINT to all processes of a command, but only the driver should respond.
    Threads and processes inherit the signal mask, including workers restarted later.
    """
    resource_tracker.ensure_running()  # if started later, it would lift the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

"""Reading one file in a child process, and its outcome."""

import os
import resource
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from palpate.storage.errors import PalpateError

MEMORY_BYTES = 3 * 2**29  # 1.5 GB
SECONDS = 60
SECRET = "a-secret-beside-the-input"


@dataclass(frozen=True)
class Outcome:
    """The outcome of one input.

    Parameters
    ----------
    kind : str
        ``"refused"`` or ``"read"``; everything else is a failure.
    text : str
        The message, or a traceback.
    mib : float
        Peak resident memory, including that of the interpreter.
    seconds : float
    """

    kind: str
    text: str
    mib: float
    seconds: float

    @property
    def is_bad(self) -> bool:
        """Return True if this is a failure."""
        return (
            self.kind not in ("refused", "read")
            or SECRET in self.text
            or "Traceback" in self.text
            or not self.text.strip()
            or len(self.text) > 6000
            or self.mib > MEMORY_BYTES / 2**20
        )


def outcome_of(read: Callable[[], object]) -> Outcome:
    """Call `read` in a fork of this process, with limits on time and memory."""
    receive, send = os.pipe()
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(receive)
        text = _in_child(read)
        os.write(send, text.encode(errors="replace")[:60_000])
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as file:
        said = file.read().decode(errors="replace")
    _, status, usage = os.wait4(child, 0)
    kind, _, text = said.partition("\n")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        kind, text = ("too slow" if number == signal.SIGALRM else "killed"), f"signal {number}"
    return Outcome(kind, text, usage.ru_maxrss / 1024, time.monotonic() - began)


def _in_child(read: Callable[[], object]) -> str:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(SECONDS)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        found = read()
    except PalpateError as error:
        return f"refused\n{error}"
    except BaseException:
        return f"traceback\n{traceback.format_exc()[-6000:]}"
    return f"read\n{type(found).__name__} {_facts(found)}"


def _facts(found: object) -> str:
    values = getattr(found, "values", None)
    return f"of shape {values.shape}" if hasattr(values, "shape") else ""


def with_secret(folder: Path) -> None:
    """Write a file next to the input that must not be read."""
    for place in (folder, folder.parent):
        (place / "secret.txt").write_text(SECRET)

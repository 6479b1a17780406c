"""Storage and timing shared by the tasks of the thesis' experiments."""

import os
import platform
import time
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import ClassVar

from palpate.storage.digest import digest
from palpate.workers.body.phantom.breast import Phantom
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.task_store import Part, TaskStore
from palpate.workers.thesis.phantoms import thesis_phantom
from palpate.workers.thesis.scale import Scale


@dataclass(frozen=True, slots=True)
class Spent:
    """Cost of a part.

    Parameters
    ----------
    wall_s, cpu_s : float
        Wall-clock seconds, and processor seconds of this process, which are fewer on a busy
        machine.
    machine : str
        Machine that computed the part.
    """

    wall_s: float
    cpu_s: float
    machine: str


@dataclass(frozen=True, slots=True)
class Timed:
    """The first field of every record, sufficient for progress reports and estimates."""

    spent: Spent


@dataclass(frozen=True)
class Request:
    """One part of an experiment, named by the fields of its class other than `store`.

    Parameters
    ----------
    store : str
        Folder visible to all workers.
    scale : str
        One of `workers.thesis.scale.SCALES`.
    """

    MODULE: ClassVar[str]

    store: str
    scale: Scale

    @property
    def part(self) -> Part:
        """Part that holds the result."""
        which = [type(self).__name__, *astuple(self)[1:]]
        return Part(TaskStore(self.store), digest("thesis", which, code_version(self.MODULE)))

    @property
    def kind(self) -> str:
        """Group of requests that take about equally long, such as `press, adaptive, CC`."""
        return type(self).__name__.lower()

    @property
    def label(self) -> str:
        """Description for users."""
        return ", ".join(str(v) for v in (type(self).__name__.lower(), *astuple(self)[2:]))

    @property
    def spent(self) -> Spent:
        """Cost of the part, once finished."""
        return self.part.record(Timed).spent


class Watch:
    """Stopwatch that starts when created.

    Examples
    --------
    >>> Watch().spent().wall_s < 1
    True
    """

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.perf_counter(), time.process_time()

    def spent(self) -> Spent:
        """Return the time spent so far."""
        wall_s, cpu_s = time.perf_counter() - self._wall_s, time.process_time() - self._cpu_s
        return Spent(wall_s, cpu_s, machine())


def machine() -> str:
    """Return the name of the processor, if known, and the number of its cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = models[0] if models else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def cached_phantom(store: str, number: int, scale: Scale) -> Phantom:
    """Return a phantom of the thesis, cached in this process."""
    make = lambda: thesis_phantom(number, scale)  # noqa: E731
    return TaskStore(store).cached(("phantom", number, scale), make)

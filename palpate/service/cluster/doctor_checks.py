"""Checks for problems that would spoil a run: mixed code, an unusable store, a full disk."""

import os
import platform
import socket
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict, TypeVar

from palpate import service, storage, workers
from palpate.service.cluster.dask_cluster import Cluster, usable_cores
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import ClusterError
from palpate.service.installed_packages import code_digest, versions
from palpate.storage.errors import PalpateError
from palpate.storage.json_digests import source_digest
from palpate.storage.store import probe_store
from palpate.workers.plugins import foreign_plugins

GIB = 1024**3
SCARCE_BYTES = 2 * GIB
Checked = TypeVar("Checked")


class ProcessFacts(TypedDict):
    """Imports and resources of one process.

    ``packages`` are the folders of Palpate's packages by name, ``source`` is the digest of all
    their code, ``code`` that of the part on which results depend; ``plugins`` are from other
    distributions.
    """

    host: str
    pid: int
    python: str
    packages: dict[str, str]
    source: str
    code: str
    versions: dict[str, str]
    plugins: list[str]
    cores: int
    memory_bytes: int
    platform: str


class KernelFacts(TypedDict):
    """The compiler that was tested, and its threads."""

    numba: str
    threads: int


class StoreFacts(TypedDict):
    """The store that was tested; ``free_bytes`` is None in a bucket.

    ``takes_once`` is true if only one of two processes can create a given name: always in a file
    system, and in an object store if it honours If-None-Match.
    """

    root: str
    free_bytes: int | None
    takes_once: bool


@dataclass(frozen=True)
class Examination:
    """The findings of the doctor.

    Parameters
    ----------
    problems : list of str
        Empty if all is well.
    processes : dict of str to ProcessFacts
        By role: client, scheduler, and each worker with its address.
    dashboard : str
        Address of Dask's page; empty if there is none.
    store : StoreFacts or None
        None if the store cannot be used.
    kernels : KernelFacts or None
        None if no kernel can be compiled.
    """

    problems: list[str]
    processes: dict[str, ProcessFacts]
    dashboard: str
    store: StoreFacts | None
    kernels: KernelFacts | None

    def as_dict(self) -> dict[str, Any]:
        """Return the record printed by `palpate doctor --json`."""
        return asdict(self)


def describe_process() -> ProcessFacts:
    """Describe this process; also run on workers and the scheduler to describe theirs."""
    from distributed.system import MEMORY_LIMIT

    packages = {
        p.__name__.removeprefix("palpate."): str(Path(str(p.__file__)).parent)
        for p in (service, workers, storage)
    }
    return {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "python": sys.executable,
        "packages": packages,
        "source": source_digest(sorted(packages.values())),
        "code": code_digest(),
        "versions": versions(),
        "plugins": [plugin.words for plugin in foreign_plugins()],
        "cores": usable_cores(),
        "memory_bytes": int(MEMORY_LIMIT or 0),
        "platform": platform.platform(),
    }


def try_kernels() -> KernelFacts:
    """Compile and run a kernel in this process.

    Raises
    ------
    RuntimeError
        If the result is wrong.
    """
    import numba
    import numpy as np

    @numba.njit(nogil=True)
    def total(values: Any) -> float:
        result = 0.0
        for value in values:
            result += value
        return result

    result = float(total(np.arange(10.0)))
    if result != 45.0:
        raise RuntimeError(f"numba added 0 to 9 and got {result}")
    return {"numba": numba.__version__, "threads": numba.get_num_threads()}


def try_store(location: str) -> StoreFacts:
    """Write, read and list files from this process, and measure the free space.

    Raises
    ------
    StoreError
        If the store cannot be used.
    """
    probe = probe_store(location)
    return {"root": probe.root, "free_bytes": probe.free_bytes, "takes_once": probe.takes_once}


def examine(cluster: Cluster, store: str) -> Examination:
    """Check the client, the scheduler, the workers and the store."""
    problems: list[str] = []
    processes = {"client": describe_process()}
    processes |= _cluster_processes(cluster, problems)
    problems += _mixed(processes)
    store_facts = _try("the store cannot be used here", lambda: try_store(store), problems)
    kernels = _try("numba does not work here", try_kernels, problems)
    if any(role.startswith("worker") for role in processes):
        dispatcher = Dispatcher(cluster.client, no_ending_s=120.0)
        what = "a worker cannot use the store: all need the same folder"
        _try(what, lambda: dispatcher.call(try_store, store), problems)
        _try("numba does not work on a worker", lambda: dispatcher.call(try_kernels), problems)
    if store_facts is not None:
        problems += _store_problems(store_facts)
    return Examination(problems, processes, cluster.dashboard, store_facts, kernels)


def _store_problems(facts: StoreFacts) -> list[str]:
    problems = []
    free = facts["free_bytes"]
    if free is not None and free < SCARCE_BYTES:
        problems.append(f"only {free / GIB:.1f} GiB are free on the disk of the store")
    if not facts["takes_once"]:
        problems.append(
            "the object store ignores If-None-Match: studies are safe, but two maintenance "
            "commands (migrate, gc --delete, check --repair) can run at once. Use a server that "
            "honours it, or make sure that only one runs"
        )
    return problems


def _cluster_processes(cluster: Cluster, problems: list[str]) -> dict[str, ProcessFacts]:
    try:
        scheduler = cluster.client.run_on_scheduler(describe_process)
        by_address = cluster.client.run(describe_process, on_error="return")
    except Exception as error:
        problems.append(f"the scheduler cannot run palpate's code: {error}")
        return {}
    processes: dict[str, ProcessFacts] = {"scheduler": scheduler}
    for address, facts in by_address.items():
        if isinstance(facts, Exception):
            problems.append(f"the worker {address} cannot run palpate's code: {facts}")
        else:
            processes[f"worker {address}"] = facts
    if not by_address:
        problems.append(str(ClusterError("the scheduler has no workers")))
    return processes


def _mixed(processes: Mapping[str, ProcessFacts]) -> list[str]:
    """Describe forbidden differences between the processes."""
    here = processes["client"]
    problems = []
    for role, facts in processes.items():
        if facts["source"] != here["source"]:
            problems.append(
                f"{role} on {facts['host']} has a different version of palpate "
                f"({facts['packages']['workers']}) from the client "
                f"({here['packages']['workers']}): install the same version everywhere"
            )
        for name, version in facts["versions"].items():
            if name != "code" and version != here["versions"][name]:
                problems.append(f"{role} has {name} {version}, the client {here['versions'][name]}")
        lacking = [words for words in here["plugins"] if words not in facts["plugins"]]
        problems += [f"{role} lacks the plug-in {words}" for words in lacking]
    return problems


def _try(what: str, check: Callable[[], Checked], problems: list[str]) -> Checked | None:
    try:
        return check()
    except PalpateError as error:
        problems.append(f"{what}: {error}")
    except Exception as error:
        problems.append(f"{what}: {type(error).__name__}: {error}")
    return None

"""Looks for what would spoil a run: mixed versions, a store that cannot be written, no room."""

import os
import platform
import shutil
import socket
import sys
from pathlib import Path
from typing import Any

import storage
import workers
from service.cluster import Cluster, usable_cores
from service.dispatch import Dispatcher
from service.errors import ClusterError
from service.versions import code_digest, versions
from storage.digest import source_digest
from storage.errors import PalpateError
from storage.stores import open_store

Json = dict[str, Any]
GIB = 1024**3
SCARCE_BYTES = 2 * GIB


def describe_process() -> Json:
    """Of this process: which packages it imports, from where, and what it may use.

    Sent to workers and scheduler as it is, so that they tell of their own.
    """
    from distributed.system import MEMORY_LIMIT

    import service

    packages = {p.__name__: str(Path(str(p.__file__)).parent) for p in (service, workers, storage)}
    return {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "python": sys.executable,
        "packages": packages,
        "source": source_digest(sorted(packages.values())),
        "code": code_digest(),
        "versions": versions(),
        "cores": usable_cores(),
        "memory_bytes": int(MEMORY_LIMIT or 0),
        "platform": platform.platform(),
    }


def try_kernels() -> Json:
    """Compile and run a kernel in this process.

    Raises
    ------
    RuntimeError
        If it gives a wrong result.
    """
    import numba
    import numpy as np

    @numba.njit(nogil=True)
    def total(values: Any) -> float:
        result = 0.0
        for value in values:
            result += value
        return result

    found = float(total(np.arange(10.0)))
    if found != 45.0:
        raise RuntimeError(f"numba added 0 to 9 and got {found}")
    return {"numba": numba.__version__, "threads": numba.get_num_threads()}


def try_store(location: str) -> Json:
    """Write to the store from this process, and see how much room there is.

    Raises
    ------
    StoreError
        If it cannot be used.
    """
    store = open_store(location)
    probe = store.root / f".palpate-probe-{os.getpid()}"
    probe.write_bytes(b"\0" * 4096)
    probe.unlink()
    return {"root": str(store.root), "free_bytes": shutil.disk_usage(store.root).free}


def examine(cluster: Cluster, store: str) -> Json:
    """Look at client, scheduler, workers and store.

    Returns
    -------
    dict
        ``problems`` (texts; empty when all is well), ``processes`` by role, ``store``,
        ``kernels``, ``dashboard``.
    """
    problems: list[str] = []
    here = describe_process()
    processes: Json = {"client": here}
    processes |= _cluster_processes(cluster, problems)
    problems += _mixed(processes)
    checked = {
        "store": _try("the store cannot be used here", lambda: try_store(store), problems),
        "kernels": _try("numba does not work here", try_kernels, problems),
    }
    if any(role.startswith("worker") for role in processes):
        dispatcher = Dispatcher(cluster.client, no_ending_s=120.0)
        said = "a worker cannot use the store: all need the same folder"
        _try(said, lambda: dispatcher.call(try_store, store), problems)
        _try("numba does not work on a worker", lambda: dispatcher.call(try_kernels), problems)
    free = (checked["store"] or {}).get("free_bytes", SCARCE_BYTES)
    if free < SCARCE_BYTES:
        problems.append(f"only {free / GIB:.1f} GiB are free where the store is")
    return {
        "problems": problems,
        "processes": processes,
        "dashboard": cluster.dashboard,
        **checked,
    }


def _cluster_processes(cluster: Cluster, problems: list[str]) -> Json:
    try:
        scheduler = cluster.client.run_on_scheduler(describe_process)
        found = cluster.client.run(describe_process, on_error="return")
    except Exception as error:
        problems.append(f"the scheduler cannot run palpate's code: {error}")
        return {}
    processes: Json = {"scheduler": scheduler}
    for address, told in found.items():
        if isinstance(told, Exception):
            problems.append(f"the worker {address} cannot run palpate's code: {told}")
        else:
            processes[f"worker {address}"] = told
    if not found:
        problems.append(str(ClusterError("the scheduler has no workers")))
    return processes


def _mixed(processes: Json) -> list[str]:
    """What differs between the processes that must not."""
    here = processes["client"]
    problems = []
    for role, told in processes.items():
        if told["source"] != here["source"]:
            problems.append(
                f"{role} on {told['host']} has another palpate ({told['packages']['workers']}) "
                f"than the client ({here['packages']['workers']}): install the same everywhere"
            )
        for name, version in told["versions"].items():
            if name != "code" and version != here["versions"][name]:
                problems.append(f"{role} has {name} {version}, the client {here['versions'][name]}")
    return problems


def _try(what: str, check: Any, problems: list[str]) -> Json | None:
    try:
        return dict(check())
    except PalpateError as error:
        problems.append(f"{what}: {error}")
    except Exception as error:
        problems.append(f"{what}: {type(error).__name__}: {error}")
    return None

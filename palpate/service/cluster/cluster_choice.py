"""The cluster that a user asks for: a number of workers here, or the address of a scheduler.

The number of workers of a local cluster is fixed, or a range that follows the work. An address is
checked quickly, before Dask is loaded, so nothing here imports Dask.
"""

import re
import socket
import time
from dataclasses import dataclass
from typing import TypeAlias

from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.errors import InputError

_WORKER_RANGE = re.compile(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?")


@dataclass(frozen=True)
class WorkerRange:
    """From `least` to `most` workers, depending on the work.

    Parameters
    ----------
    least : int
        Number kept when there is no work; >= 1.
    most : int
        > `least`.
    """

    least: int
    most: int

    def __str__(self) -> str:
        """Return the range as a user types it."""
        return f"{self.least}-{self.most}"


Workers: TypeAlias = int | WorkerRange
"""A number of workers, or a range."""


def read_workers(text: str, option: str = "--workers ") -> Workers:
    """Read a number of workers such as ``4``, or a range such as ``1-4``.

    Parameters
    ----------
    text : str
    option : str
        The option as typed, for messages.

    Raises
    ------
    InputError
        If the text is neither, or the number is too small.

    Examples
    --------
    >>> read_workers("4")
    4
    >>> read_workers("1-4")
    WorkerRange(least=1, most=4)
    """
    match = _WORKER_RANGE.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"{option}{text}: expected a number of workers such as 4, or a range such as 1-4 "
            "(fewest-most)."
        )
    least, most = int(match[1]), int(match[2] or match[1])
    if least < 1:
        raise InputError(
            f"{option.rstrip(' =')} must be at least 1, got {text}: one worker is always kept."
        )
    if most < least:
        raise InputError(f"{option}{text}: give the smaller number first: {most}-{least}.")
    return least if most == least else WorkerRange(least, most)


def most_workers(workers: Workers) -> int:
    """Return the largest number of workers."""
    return workers.most if isinstance(workers, WorkerRange) else workers


_ADDRESS = re.compile(
    r"(?:(?P<scheme>[a-z]+)://)?(?P<host>\[[^\]]+\]|[^\s:/@]+):(?P<port>\d{1,5})/?"
)
SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")
ADDRESS_ADVICE = (
    "Give an address such as tcp://127.0.0.1:8786 (`dask scheduler` prints its own). To use this "
    "machine, leave out --scheduler, and unset PALPATE_SCHEDULER if that names it."
)
RETRY_S = 0.25


def host_and_port(address: str) -> tuple[str, int]:
    """Return the host and port of an address.

    Raises
    ------
    ClusterError
        If it is not the address of a scheduler.
    """
    match = _ADDRESS.fullmatch(address.strip())
    port = int(match["port"]) if match else 0
    if match is None or not 0 < port < 65536 or (match["scheme"] or "tcp") not in SCHEMES:
        raise ClusterError(
            f"There is no scheduler at {address!r}: invalid address. {ADDRESS_ADVICE}"
        )
    return match["host"].strip("[]"), port


def check_reachable(address: str, patience_s: float) -> None:
    """Wait until something listens at an address.

    Parameters
    ----------
    address : str
        Such as ``tcp://10.0.0.5:8786``.
    patience_s : float
        How long to wait for a scheduler that is starting; an unknown host fails at once.

    Raises
    ------
    ClusterError
        If nothing listens in time.
    """
    host, port = host_and_port(address)
    deadline = time.monotonic() + patience_s
    while True:
        left_s = max(0.1, deadline - time.monotonic())
        try:
            socket.create_connection((host, port), timeout=left_s).close()
        except (socket.gaierror, UnicodeError) as error:
            raise ClusterError(
                f"There is no scheduler at {address}: the host {host!r} is unknown. "
                f"{ADDRESS_ADVICE}"
            ) from error
        except OSError as error:
            if time.monotonic() + RETRY_S >= deadline:
                reason = error.strerror or str(error)
                raise ClusterError(
                    f"There is no scheduler at {address}: {reason}. Start one with `dask "
                    "scheduler`. To use this machine, leave out --scheduler, and unset "
                    "PALPATE_SCHEDULER if that names it."
                ) from error
            time.sleep(RETRY_S)
        else:
            return

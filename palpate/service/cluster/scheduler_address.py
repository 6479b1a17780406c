"""Quick check of a scheduler's address, before Dask is loaded."""

import re
import socket
import time

from palpate.service.errors import ClusterError

_ADDRESS = re.compile(
    r"(?:(?P<scheme>[a-z]+)://)?(?P<host>\[[^\]]+\]|[^\s:/@]+):(?P<port>\d{1,5})/?"
)
SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")
ADVICE = (
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
        raise ClusterError(f"There is no scheduler at {address!r}: invalid address. {ADVICE}")
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
                f"There is no scheduler at {address}: the host {host!r} is unknown. {ADVICE}"
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

"""Retries of a container's command, where they may help.

::

    python -m palpate.service.cluster.container_retry palpate run ...


A container engine restarts anything that fails. A study with invalid input ends with exit
code 2, every time; only other failures are retried. (A candidate whose worker died is sent again
by `service.cluster.task_dispatch`.)
"""

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

# Success, an error for the user to correct, and a requested stop.
FINAL = (0, 2, 130)
ATTEMPTS = 4
PAUSE_S = 5.0


def main(command: Sequence[str], pause_s: float = PAUSE_S) -> int:
    """Run a command until it succeeds or retrying is pointless, and return its exit code."""
    stopped: list[int] = []
    running: list[subprocess.Popen[bytes]] = []

    def stop(number: int, frame: Any) -> None:
        stopped.append(number)
        for process in running:
            process.send_signal(number)

    before = {s: signal.signal(s, stop) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        for attempt in range(1, ATTEMPTS + 1):
            with subprocess.Popen(command) as process:
                running[:] = [process]
                code = process.wait()
            running.clear()
            if code in FINAL or stopped or attempt == ATTEMPTS:
                break
            sys.stderr.write(f"ended with {code}; {ATTEMPTS - attempt} attempts left\n")
            time.sleep(pause_s)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

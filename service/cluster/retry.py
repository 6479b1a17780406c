"""Run a command again where that may help.

::

    python -m palpate.service.cluster.retry palpate run ...


A container engine restarts whatever ends badly. A study that makes no sense ends with exit
code 2, and ends so again however often it is started; only other failures are tried again.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

# Done, something that the user has to put right, and a wish to stop.
FINAL = (0, 2, 130)
ATTEMPTS = 4
PAUSE_S = 5.0


def main(command: Sequence[str], pause_s: float = PAUSE_S) -> int:
    """Run a command until it ends for good, and return its exit code."""
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
            sys.stderr.write(f"ended with {code}: tried again, {ATTEMPTS - attempt} times more\n")
            time.sleep(pause_s)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

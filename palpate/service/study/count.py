"""Counts of a study for the terminal, the pages, the service and Dask's dashboard.

Evaluations are counted once they have ended, generations once all of their scores are known.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping

RATE_OVER_S = 300.0
# A rate is shown after this many evaluations, and after one for each worker.
FIRST_EVALUATIONS = 3
FAILED = ("diverged", "crashed", "lost")


def ended_of(counts: Mapping[str, int]) -> int:
    """Return the number of evaluations that have ended, given the counts by status."""
    return sum(counts.get(status, 0) for status in ("done", *FAILED))


def evaluations_text(counts: Mapping[str, int], at_most: int) -> str:
    """Return the number of evaluations as text.

    Examples
    --------
    >>> evaluations_text({"done": 1200, "diverged": 3}, 1260)
    '1,203 of at most 1,260 (3 diverged)'
    """
    failed = ", ".join(f"{counts[s]:,} {s}" for s in FAILED if counts.get(s))
    text = f"{ended_of(counts):,} of at most {at_most:,}"
    return f"{text} ({failed})" if failed else text


def generations_text(complete: int, at_most: int) -> str:
    """Return the number of complete generations as text."""
    return f"{complete:,} of at most {at_most:,} complete"


class Pace:
    """Evaluations per minute, measured while they are computed.

    Parameters
    ----------
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began: float | None = None
        self._count = 0
        self._recent: deque[float] = deque(maxlen=10_000)

    def add(self, seconds: float) -> None:
        """Add an evaluation that has just ended and its duration in seconds."""
        now = self._clock()
        if self._began is None:
            self._began = now - seconds
        self._count += 1
        self._recent.append(now)

    def per_minute(self, workers: int = 1) -> float | None:
        """Return the recent rate; None before the first evaluations of all workers."""
        first = max(FIRST_EVALUATIONS, workers)
        if self._began is None or self._count < first:
            return None
        now = self._clock()
        recent = [at for at in list(self._recent) if now - at < RATE_OVER_S]
        watched_s = now - self._began
        if watched_s > RATE_OVER_S and len(recent) >= first:
            return 60.0 * len(recent) / max(now - recent[0], 1e-3)
        return 60.0 * self._count / max(watched_s, 1e-3)


def left_s(counts: Mapping[str, int], at_most: int, per_minute: float | None) -> float:
    """Return the longest remaining time in seconds; infinite if the rate is unknown."""
    if not per_minute:
        return math.inf
    return 60.0 * max(0, at_most - ended_of(counts)) / per_minute

"""Says how many workers a cluster has that we start: a number, or a range that follows the work."""

import re
from dataclasses import dataclass
from typing import TypeAlias

from palpate.storage.errors import InputError

_RANGE = re.compile(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?")


@dataclass(frozen=True)
class WorkerRange:
    """From `least` to `most` workers, as many as there is work for.

    Parameters
    ----------
    least : int
        >= 1; so many are kept when there is nothing to do.
    most : int
        > `least`.
    """

    least: int
    most: int

    def __str__(self) -> str:
        """Return what a user types."""
        return f"{self.least}-{self.most}"


Workers: TypeAlias = int | WorkerRange
"""A number of workers, or a range."""


def read_workers(text: str, option: str = "--workers ") -> Workers:
    """Read a number of workers such as ``4``, or a range such as ``1-4``.

    Parameters
    ----------
    text : str
    option : str
        What stands before it where it was typed.

    Raises
    ------
    InputError
        If it is neither, or there are too few.

    Examples
    --------
    >>> read_workers("4")
    4
    >>> read_workers("1-4")
    WorkerRange(least=1, most=4)
    """
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"{option}{text}: expected a number of workers such as 4, or the least and the most "
            "of them such as 1-4."
        )
    least, most = int(match[1]), int(match[2] or match[1])
    if least < 1:
        raise InputError(
            f"{option.rstrip(' =')} must be at least 1, got {text}: one worker is always kept."
        )
    if most < least:
        raise InputError(f"{option}{text}: the least comes first, so {most}-{least}.")
    return least if most == least else WorkerRange(least, most)


def most_workers(workers: Workers) -> int:
    """Return how many there are at most."""
    return workers.most if isinstance(workers, WorkerRange) else workers

"""The number of workers of a local cluster: fixed, or a range that follows the work."""

import re
from dataclasses import dataclass
from typing import TypeAlias

from palpate.storage.errors import InputError

_RANGE = re.compile(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?")


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
    match = _RANGE.fullmatch(text.strip())
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

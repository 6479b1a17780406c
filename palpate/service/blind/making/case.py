"""The task that makes one case of a blind set. No diagnosis imports this module."""

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypedDict

from palpate.storage.backends.atomic import PREFIX, discard, explained
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.solver.newton import NoEquilibriumError
from palpate.workers.blind.world import World
from palpate.workers.blind.write_case import write_case

ATTEMPTS = 5
# All files get the same time, so that it reveals nothing about the case.
NO_TIME = (0, 0)


class CaseMade(TypedDict):
    """Seconds taken by a case, and the number of draws it needed."""

    seconds: float
    attempts: int


def make_case(
    seed: int, kind: str, one_direction: bool, world: str, case: str, truth: str
) -> CaseMade:
    """Draw a case, and write it and its truth to two folders, each whole or not at all.

    Parameters
    ----------
    seed : int
    kind : str
        See `workers.blind.random_case.KINDS`.
    one_direction : bool
        Whether all scans are pressed along y.
    world : str
        See `workers.blind.world.World`.
    case, truth : str
        Folders to create, both of the same name. The case is moved into place last.

    Returns
    -------
    CaseMade
        A draw without an equilibrium between the plates is repeated with the next seed.
    """
    begun = time.perf_counter()
    for attempt in range(ATTEMPTS):
        drawn = draw(seed + attempt, kind, one_direction=one_direction, world=World(world))
        try:
            publish(Path(case), Path(truth), partial(write_case, drawn))
        except NoEquilibriumError:
            if attempt + 1 == ATTEMPTS:
                raise
            continue
        break
    return {"seconds": time.perf_counter() - begun, "attempts": attempt + 1}


def publish(case: Path, truth: Path, write: Callable[[Path, Path], object]) -> None:
    """Write a case and its truth in scratch folders, then move them into place."""
    with explained(case), _beside(case) as new_case, _beside(truth) as new_truth:
        write(new_case, new_truth)
        for file in new_case.iterdir():
            os.utime(file, NO_TIME)
        discard(truth)
        new_truth.rename(truth)
        discard(case)
        new_case.rename(case)


class _beside:  # noqa: N801 - a context manager
    """Make a folder of the same name in a hidden sibling folder, removed at the end."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._hidden = tempfile.TemporaryDirectory(
            prefix=PREFIX, dir=path.parent, ignore_cleanup_errors=True
        )
        self._name = path.name

    def __enter__(self) -> Path:
        made = Path(self._hidden.name, self._name)
        made.mkdir()
        return made

    def __exit__(self, *error: object) -> None:
        self._hidden.cleanup()

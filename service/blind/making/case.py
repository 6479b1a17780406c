"""Makes one case of a blind set, as a task. No diagnosis imports this file."""

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
# A case tells nothing by the time at which it was made.
NO_TIME = (0, 0)


class CaseMade(TypedDict):
    """Seconds that a case took, and how many draws it needed."""

    seconds: float
    attempts: int


def make_case(
    seed: int, kind: str, one_direction: bool, world: str, case: str, truth: str
) -> CaseMade:
    """Draw a case and write it, with its truth elsewhere; both are whole or not there.

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
        Folders that are made here, both of the same name. A case is there last.

    Returns
    -------
    CaseMade
        A draw that stands between no plates is drawn again with the next seed.
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
    """Have a case and its truth written under their own names, then put them in their places."""
    with explained(case), _beside(case) as new_case, _beside(truth) as new_truth:
        write(new_case, new_truth)
        for file in new_case.iterdir():
            os.utime(file, NO_TIME)
        discard(truth)
        new_truth.rename(truth)
        discard(case)
        new_case.rename(case)


class _beside:  # noqa: N801 - a context manager
    """Make a folder of the same name in a hidden one beside it that goes at the end."""

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

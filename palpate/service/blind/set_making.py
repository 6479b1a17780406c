"""Making a blind set: a plan, the task that makes one case, and a manifest that seals them.

No diagnosis imports this module.
"""

import os
import secrets
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from palpate.service.blind.sealed_diagnosis import frozen
from palpate.service.blind.sealed_set import (
    BlindSet,
    CaseHashes,
    PlannedCase,
    Truths,
    check_cases,
    check_truths,
    file_hash,
    folder_hash,
    new_salt,
    read_json,
    read_manifest,
    salted_hash,
    write_json,
)
from palpate.service.cluster.task_dispatch import Dispatcher, Ending
from palpate.service.errors_and_interrupts import ClusterError, TaskError
from palpate.storage.backends.atomic_files import PREFIX, discard, explained
from palpate.storage.errors import InputError, PalpateError
from palpate.storage.json_digests import to_json
from palpate.workers.blind.case_deviations import World
from palpate.workers.blind.case_files import write_case
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.solver.plate_equilibrium import NoEquilibriumError

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
        See `workers.blind.case_deviations.World`.
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


ID_BYTES = 4


@dataclass(frozen=True)
class SetRequest:
    """The settings of a set.

    Parameters
    ----------
    cases : int
        Number of cases, > 0.
    seed : int or None
        Seed of all cases; None draws a seed that nobody knows.
    one_direction : bool
        Whether all scans are pressed along y.
    nodes : int
        Nodes of the diagnosis' working mesh, recorded in the manifest.
    controls : bool
        Whether to make only controls: null replicates by full simulation.
    world : str
        See `workers.blind.case_deviations.World`.
    """

    cases: int
    seed: int | None
    one_direction: bool
    nodes: int
    controls: bool = False
    world: str = "plain"

    @property
    def rules(self) -> dict[str, bool | str]:
        """Return the settings, other than the seed, on which the cases of a set depend."""
        return {"one_direction": self.one_direction, "controls": self.controls, "world": self.world}


def plan(
    blind: BlindSet, truths: Truths, request: SetRequest, shares: Mapping[str, float]
) -> list[PlannedCase]:
    """Plan seeds, kinds, names and salts, or read the plan of an earlier call.

    Parameters
    ----------
    shares : mapping of str to float
        Frequency of each kind, on any scale.

    Returns
    -------
    list of PlannedCase
        In the order of the names.

    Raises
    ------
    InputError
        If the earlier call had other settings, or its truths are elsewhere.
    """
    if truths.plan.is_file():
        return _planned_before(truths, request)
    if blind.manifest.is_file():
        raise InputError(
            f"{blind.root} is sealed, and its truths are not in {truths.root}. Give their folder "
            "with --truth, or make a new SET."
        )
    seed = secrets.randbits(48) if request.seed is None else request.seed
    kinds = shared_out(shares, request.cases)
    names = _names(request.cases)
    entries: list[PlannedCase] = [
        {"id": name, "seed": seed_of(seed, number), "kind": kind, "salt": new_salt()}
        for number, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]
    entries.sort(key=lambda entry: str(entry["id"]))
    with explained(truths.root):
        truths.root.mkdir(parents=True, exist_ok=True)
    write_json(truths.plan, {"seed": seed} | request.rules | {"cases": entries})
    return entries


def _planned_before(truths: Truths, request: SetRequest) -> list[PlannedCase]:
    """Read the plan of an earlier call, and reject a plan for another set."""
    earlier = read_json(truths.plan)
    before = {"controls": False, "world": "plain"} | earlier  # older plans lack these keys
    rules = {name: before[name] for name in request.rules}
    same_seed = request.seed in (None, earlier["seed"])
    if len(earlier["cases"]) != request.cases or rules != request.rules or not same_seed:
        raise InputError(
            f"{truths.plan} plans another set ({len(earlier['cases'])} cases, seed "
            f"{earlier['seed']}, one direction: {rules['one_direction']}, controls only: "
            f"{rules['controls']}, world: {rules['world']}). Use the same options, or a new SET."
        )
    return list(earlier["cases"])


def unmade(blind: BlindSet, truths: Truths, entries: Sequence[PlannedCase]) -> list[PlannedCase]:
    """Return the cases of a plan that are not made yet; none for a sealed set."""
    if blind.manifest.is_file():
        return []
    names = (entry["id"] for entry in entries)
    there = {name for name in names if blind.case(name).is_dir() and truths.of(name).is_dir()}
    return [entry for entry in entries if entry["id"] not in there]


def make(
    blind: BlindSet,
    truths: Truths,
    entries: Sequence[PlannedCase],
    request: SetRequest,
    dispatcher: Dispatcher,
    tell: Callable[[], object],
    task: Callable[..., object],
) -> None:
    """Make cases in the order of their names, which is independent of their kinds.

    Parameters
    ----------
    entries : sequence of PlannedCase
        As returned by `unmade`.
    tell : callable
        Called when a case is made.
    task : callable
        See `service.blind.set_making.make_case`.

    Raises
    ------
    StoreError
        If the set cannot be written.
    ClusterError, TaskError
        If the workers cannot do the work; completed cases are kept.
    Interrupted
        If the dispatcher is stopped.
    """

    def arguments(entry: PlannedCase) -> tuple[str, tuple[Any, ...]]:
        name = entry["id"]
        folders = (str(f.absolute()) for f in (blind.case(name), truths.of(name)))
        return name, (entry["seed"], entry["kind"], request.one_direction, request.world, *folders)

    for ending in dispatcher.run(task, map(arguments, entries)):
        if ending.value is None:
            raise _failed(ending)
        tell()


def seal(
    blind: BlindSet, truths: Truths, entries: Sequence[PlannedCase], request: SetRequest
) -> str:
    """Write the manifest, or check the existing one.

    Returns
    -------
    str
        The SHA-256 of the manifest.

    Raises
    ------
    InputError
        If a sealed case or truth has changed.
    """
    if blind.manifest.is_file():
        manifest = read_manifest(blind)
        check_cases(blind, manifest)
        check_truths(truths, manifest)
        return file_hash(blind.manifest)
    cases: dict[str, CaseHashes] = {
        e["id"]: {
            "case": folder_hash(blind.case(e["id"])),
            "truth": salted_hash(e["salt"], truths.of(e["id"])),
        }
        for e in entries
    }
    return write_json(blind.manifest, {"cases": cases, "diagnosis": to_json(frozen(request.nodes))})


def shared_out(shares: Mapping[str, float], count: int) -> list[str]:
    """Distribute `count` cases among kinds, as close to their shares as whole numbers allow.

    The largest remainders are rounded up.

    Examples
    --------
    >>> shared_out({"control": 2, "tilt": 1, "friction": 1}, 6)
    ['control', 'control', 'control', 'tilt', 'tilt', 'friction']
    """
    total = sum(shares.values())
    exact = {kind: count * share / total for kind, share in shares.items()}
    whole = {kind: int(value) for kind, value in exact.items()}
    by_rest = sorted(exact, key=lambda kind: whole[kind] - exact[kind])
    for kind in by_rest[: count - sum(whole.values())]:
        whole[kind] += 1
    return [kind for kind, number in whole.items() for _ in range(number)]


def seed_of(seed: int, number: int) -> int:
    """Return the seed of one case, independent of the seeds of the others."""
    return int(np.random.SeedSequence((seed, number)).generate_state(1, np.uint64)[0] >> 1)


def _names(count: int) -> list[str]:
    names: set[str] = set()
    while len(names) < count:
        names.add(secrets.token_hex(ID_BYTES))
    return list(names)


def _failed(ending: Ending) -> Exception:
    if isinstance(ending.error, PalpateError):
        return ending.error
    if ending.kind == "lost":
        return ClusterError(
            f"The case {ending.key} was lost: {ending.reason}. Give the workers more memory, or "
            "start fewer with --workers; run the same command again to continue."
        )
    return TaskError(
        f"The case {ending.key} could not be made: {ending.reason}.\n{ending.traceback}"
    )

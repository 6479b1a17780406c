"""Making a blind set: a plan, the cases, and a manifest that seals them."""

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.service.blind.sealed.seal import (
    file_hash,
    folder_hash,
    new_salt,
    read_json,
    salted_hash,
    write_json,
)
from palpate.service.blind.sealed.sealed_settings import frozen
from palpate.service.blind.sealed.sets import (
    BlindSet,
    CaseHashes,
    PlannedCase,
    Truths,
    check_cases,
    check_truths,
    read_manifest,
)
from palpate.service.cluster.dispatch import Dispatcher, Ending
from palpate.service.errors import ClusterError, TaskError
from palpate.storage.backends.atomic import explained
from palpate.storage.errors import InputError, PalpateError
from palpate.storage.records.typed_json import to_json

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
        See `workers.blind.world.World`.
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
        return {
            "one_direction": self.one_direction,
            "controls": self.controls,
            "world": self.world,
        }


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
        See `service.blind.making.case.make_case`.

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

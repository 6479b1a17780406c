"""Makes a blind set: a plan, the cases, and a manifest that seals them."""

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.blind.frozen import frozen
from service.blind.seal import file_hash, folder_hash, new_salt, read_json, salted_hash, write_json
from service.blind.sets import BlindSet, Truths, check_cases, check_truths, read_manifest
from service.dispatch import Dispatcher, Ending
from service.errors import ClusterError, TaskError
from storage.atomic import explained
from storage.errors import InputError, PalpateError

Json = dict[str, Any]
ID_BYTES = 4


@dataclass(frozen=True)
class Asked:
    """What a set shall be.

    Parameters
    ----------
    cases : int
        How many, > 0.
    seed : int or None
        Of all cases; None draws one, so that nobody knows it.
    one_direction : bool
        Whether all scans are pressed along y.
    nodes : int
        Of the diagnosis' working mesh, which the manifest freezes.
    controls : bool
        Whether no body lacks anything: null replicates by full simulation.
    """

    cases: int
    seed: int | None
    one_direction: bool
    nodes: int
    controls: bool = False

    @property
    def rules(self) -> Json:
        """What the cases of a set depend on besides its seed."""
        return {"one_direction": self.one_direction, "controls": self.controls}


def plan(blind: BlindSet, truths: Truths, asked: Asked, shares: Mapping[str, float]) -> list[Json]:
    """Seeds, kinds, names and salts: those of an earlier call if there was one.

    Parameters
    ----------
    shares : mapping of str to float
        How often each kind is drawn, on any scale.

    Returns
    -------
    list of dict
        ``id``, ``seed``, ``kind`` and ``salt`` of each case, in the order of the names.

    Raises
    ------
    InputError
        If the earlier call asked for another set, or its truths are elsewhere.
    """
    wanted = {"cases": asked.cases} | asked.rules
    if truths.plan.is_file():
        found = read_json(truths.plan)
        before = {"cases": len(found["cases"])} | {k: found.get(k, False) for k in asked.rules}
        if before != wanted or asked.seed not in (None, found["seed"]):
            raise InputError(
                f"{truths.plan} plans another set ({before['cases']} cases, seed {found['seed']}, "
                f"one direction: {before['one_direction']}, controls only: {before['controls']}). "
                "Ask for the same, or for a new SET."
            )
        return list(found["cases"])
    if blind.manifest.is_file():
        raise InputError(
            f"{blind.root} is sealed, and its truths are not in {truths.root}. Give their folder "
            "by --truth, or make a new SET."
        )
    seed = secrets.randbits(48) if asked.seed is None else asked.seed
    kinds = shared_out(shares, asked.cases)
    names = _names(asked.cases)
    entries = [
        {"id": name, "seed": seed_of(seed, number), "kind": kind, "salt": new_salt()}
        for number, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]
    entries.sort(key=lambda entry: str(entry["id"]))
    with explained(truths.root):
        truths.root.mkdir(parents=True, exist_ok=True)
    write_json(truths.plan, {"seed": seed} | asked.rules | {"cases": entries})
    return entries


def unmade(blind: BlindSet, truths: Truths, entries: Sequence[Json]) -> list[Json]:
    """The part of a plan that waits to be made; a sealed set has none."""
    if blind.manifest.is_file():
        return []
    names = (entry["id"] for entry in entries)
    there = {name for name in names if blind.case(name).is_dir() and truths.of(name).is_dir()}
    return [entry for entry in entries if entry["id"] not in there]


def make(
    blind: BlindSet, truths: Truths, entries: Sequence[Json], asked: Asked,
    dispatcher: Dispatcher, tell: Callable[[], object], task: Callable[..., Json],
) -> None:  # fmt: skip
    """Make cases in the order of their names, which says nothing of their kinds.

    Parameters
    ----------
    entries : sequence of dict
        See `unmade`.
    tell : callable
        Called when a case is made.
    task : callable
        See `service.blind.making.make_case`.

    Raises
    ------
    StoreError
        If the set cannot be written.
    ClusterError, TaskError
        If the workers cannot do the work; what is made is kept.
    Interrupted
        If the dispatcher is told to stop.
    """

    def one(entry: Json) -> tuple[str, tuple[Any, ...]]:
        name = entry["id"]
        folders = (str(f.absolute()) for f in (blind.case(name), truths.of(name)))
        return name, (entry["seed"], entry["kind"], asked.one_direction, *folders)

    for ending in dispatcher.run(task, map(one, entries)):
        if ending.value is None:
            raise _failed(ending)
        tell()


def seal(blind: BlindSet, truths: Truths, entries: Sequence[Json], asked: Asked) -> str:
    """Write the manifest, or check the one that is there.

    Returns
    -------
    str
        Its SHA-256.

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
    cases = {
        e["id"]: {
            "case": folder_hash(blind.case(e["id"])),
            "truth": salted_hash(e["salt"], truths.of(e["id"])),
        }
        for e in entries
    }
    return write_json(blind.manifest, {"cases": cases, "diagnosis": frozen(asked.nodes)})


def shared_out(shares: Mapping[str, float], count: int) -> list[str]:
    """`count` kinds, as near to their shares as whole numbers come (largest remainders).

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
    """The seed of one case: independent of those of the others."""
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
            "start fewer with --workers; the same command goes on."
        )
    return TaskError(
        f"The case {ending.key} could not be made: {ending.reason}.\n{ending.traceback}"
    )

"""Fast stand-ins for the real tasks, with the same contract.

They keep the contract of `workers.tasks.study_tasks`: idempotent, the record stored last,
divergence an ordinary ending, everything a function of the request. Each execution adds one
line to `LOG` when the evaluation is finished.

A file `MANNERS` in the store makes them slow, or makes them crash or die if the first gene is
above a bound. With `held_after`, at most that many evaluations of the store are finished until
it is changed (plus one for each worker, if several count at the same time), so later actions of a
test happen in the middle of a study, however slow the machine is.
"""

import json
import math
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.cluster.task_dispatch import Ending
from palpate.service.study.loop import Conclusion, Study
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec, parse_spec
from palpate.service.study.task_requests import Tasks
from palpate.storage.backends.store_paths import Location, StudyLayout
from palpate.storage.errors import StoreError
from palpate.storage.journal import LineChain
from palpate.storage.json_digests import CHECKSUM_KEY, digest
from palpate.storage.store import Store, load_evaluation, open_store, save_evaluation
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.tasks.pipeline import with_priors

Record = dict[str, Any]
LOG = "executions.log"
KEPT = "kept.log"
MANNERS = "manners.json"
TRUTH = {"E_fat": 0.010, "E_glandular": 0.040}
SPEC = """
name: demo
case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 12
  generations: 5
seed: 7
"""


def small_spec(text: str = SPEC) -> StudySpec:
    return parse_spec(text, "the test's study", Path())


def prepare(case: Record, store: str) -> Record:
    open_store(store)
    return {"volume": digest("body", case["reference"]), "mesh": "mesh", "facts": {"tissue_ml": {}}}


def target(case: Record, wanted: Record, store: str) -> Record:
    return {"target": digest(case, wanted), "kind": "simulated"}


def name_of(
    case: Record,
    prepared: Record,
    target: str,
    constants: Record,
    score: Record,
    free: Sequence[Record] = (),
) -> str:
    return digest(case, prepared, target, constants, score, *([list(free)] if free else []))


def level(
    case: Record, prepared: Record, target: str, spacing: float, nodes: int, store: str
) -> Record:
    coarse = case | {"mesh": {"nodes": nodes, "element_size_mm": None}}
    return {"case": coarse, "prepared": prepared | {"mesh": f"mesh {nodes}"}, "target": target}


def fit_of(constants: Record, free: Sequence[Record]) -> Record:
    """Return residuals c / true - 1 of each constant, twenty of each, with a noise of 0.01.

    Nuisance parameters, which no candidate has, change nothing.
    """
    names = [p["name"] for p in free]
    constants = {name: TRUTH.get(name, 0.1) for name in names} | dict(constants)
    ratios = [constants[name] / TRUTH.get(name, 0.1) for name in names]
    squares = [[20 * (q / 0.01) ** 2 * (i == j) for j in range(len(names))]
               for i, q in enumerate(ratios)]  # fmt: skip
    gradient = np.array([20 * (q - 1) * q / 0.01**2 for q in ratios])
    cost = sum(20 * ((q - 1) / 0.01) ** 2 for q in ratios)
    image = NormalEquations(cost, gradient, np.array(squares), 20 * len(names))
    values = [constants[name] for name in names]
    equations = with_priors(image, values, free)  # type: ignore[arg-type]
    return {
        "parameters": names,
        "logarithmic": [True] * len(names),
        "values": values,
        "residuals": equations.residuals,
        "rms_mm": 0.1,
        "cost": equations.cost,
        "gradient": equations.gradient.tolist(),
        "hessian": equations.hessian.tolist(),
        "noise": "a hundredth",
    }


def evaluate(request: Record) -> Record:
    store = open_store(request["store"])
    done = load_evaluation(store, request["digest"])
    if done is not None:
        return done | {"reused": True}
    constants = request["constants"]
    misbehave(store, constants["E_fat"])
    apart = math.hypot(*(constants[name] / true - 1 for name, true in TRUTH.items()))
    record: Record = {"digest": request["digest"], "seconds": {"solve": 0.01}, "worker": "w"}
    if constants["E_glandular"] > 0.076:
        record |= {"status": "diverged", "reason": "no equilibrium at 60 N", "score": None}
    else:
        jc = 1 / (1 + apart)
        score = {"jc": jc, "mhd_mm": apart, "mhd_voxels": apart, "gsf": math.log((1 - jc) * apart)}
        record |= {"status": "done", "reason": "", "score": score}
        if request.get("free"):
            record["fit"] = fit_of(constants, request["free"])
    save_evaluation(store, request["digest"], record)
    note(store, LOG, request["digest"])
    return record | {"reused": False}


def note(store: Store, log: str, name: str) -> None:
    """Add a line to a log, or an object to a folder of that name, safely for many processes."""
    if isinstance(store.root, Path):
        with (store.root / log).open("a") as file:  # one write
            file.write(name + "\n")
    else:
        store.backend.create(store.root / log / f"{name}.{secrets.token_hex(4)}", b"")


def misbehave(store: Store, fat: float) -> None:
    manners = manners_of(store)
    while "held_after" in manners and len(executed(store.root)) >= manners["held_after"]:
        time.sleep(0.02)
        manners = manners_of(store)
    time.sleep(manners.get("seconds", 0.0))
    if fat > manners.get("crash_above", math.inf):
        raise ZeroDivisionError(f"no such tissue: E_fat = {fat}")
    if fat > manners.get("full_disk_above", math.inf):
        raise StoreError("the disk of this worker is full")
    if fat > manners.get("hang_above", math.inf) or (
        fat > manners.get("hang_once_above", math.inf)
        and store.backend.create(store.root / f"hung-{fat}", b"")
    ):
        time.sleep(60)
    if fat > manners.get("die_above", math.inf):
        os.kill(os.getpid(), 9)


def manners_of(store: Store) -> dict[str, float]:
    path = store.root / MANNERS
    manners: dict[str, float] = {}
    if store.backend.is_file(path):
        manners = json.loads(store.backend.read(path))
    return manners


def set_manners(location: Location, **manners: float) -> None:
    store = open_store(location)
    store.backend.write(store.root / MANNERS, json.dumps(manners).encode())


def keep_volume(request: Record) -> str:
    note(open_store(request["store"]), KEPT, request["digest"])
    return str(request["digest"])


def compare(case: Record, store: str, target: str, candidate: str, score: Record) -> Record:
    return {}


TASKS = Tasks(prepare, target, evaluate, name_of, keep_volume, compare, level)


class Inline:
    """A dispatcher without a cluster that runs one task after the other in this process."""

    threads = 1

    def call(self, task: Callable[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    def all(self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]) -> Any:
        return [task(*arguments) for _, arguments in calls]

    def run(
        self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        for key, arguments in calls:
            yield Ending(key, "returned", task(*arguments))


def run(folder: Path, dispatcher: Any, spec: StudySpec | None = None, **more: Any) -> Conclusion:
    """Run a study in `folder`, with its store next to it."""
    return Study(spec or small_spec(), folder, tasks=TASKS, **more).run(dispatcher)


def told(folder: Path) -> dict[int, tuple[Any, ...]]:
    """Return the journal's content for each candidate, bit-exact, without workers and times."""
    endings = StudyLog.read(StudyLayout(folder).journal).endings
    return {
        c: (dict(r.genes), r.generation, r.digest, r.status, r.score, r.reason)
        for c, r in sorted(endings.items())
    }


def rewrite(journal: Path, records: Iterable[Record]) -> None:
    """Rewrite a journal with correct checksums, as a forger would, unlike a failing disk."""
    chain = LineChain()
    lines = [{k: v for k, v in record.items() if k != CHECKSUM_KEY} for record in records]
    journal.write_bytes(b"".join(chain.sealed(line) + b"\n" for line in lines))


def executions(folder: Path) -> list[str]:
    """Return the digests of finished evaluations, once for each time they were computed."""
    return executed(folder.parent / "store")


def executed(location: Location) -> list[str]:
    """Return the executions recorded in a store, in a folder or a bucket."""
    store = open_store(location, create=False)
    log = store.root / LOG
    if isinstance(log, Path):
        return log.read_text().split() if log.exists() else []
    return [entry.place.stem for entry in store.backend.entries(log)]


def assert_each_ran_once(folder: Path, cut_off: int = 0) -> None:
    """Check that no evaluation was computed twice, and that each in the journal was computed.

    `cut_off`: number of workers killed by signal; each may have died after its record was
    stored and before its line was logged.
    """
    ran = executions(folder)
    assert len(ran) == len(set(ran))
    finished = {ending[2] for ending in told(folder).values()}
    # For the best candidate: with derivatives, with nuisances, and on another mesh.
    assert len(set(ran) - finished) <= 3
    assert len(finished - set(ran)) <= cut_off

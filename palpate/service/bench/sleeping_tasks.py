"""Study tasks that sleep instead of computing, for measuring everything around them.

The store contains the durations in `DURATIONS`; the deviation of a candidate follows from its
digest.
"""

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from palpate.service.study.task_requests import Tasks
from palpate.storage.backends.store_paths import Location
from palpate.storage.json_digests import digest
from palpate.storage.store import Store, open_store, save_evaluation

Record = dict[str, Any]
DURATIONS = "sleeping.json"
TRUTH = {"E_fat": 0.010, "E_glandular": 0.040}
SPEC = """
name: {name}
case: {{reference: {{phantom: {{preset: 445ml}}}}, mesh: {{nodes: 2000}}}}
target: {{constants: {{E_fat_kpa: 10, E_glandular_kpa: 40}}}}
search:
  parameters: {{E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}}
  mode: {mode}
  population: {population}
  elite: 0
  generations: {generations}
  stall: null
seed: 1
"""


@dataclass(frozen=True)
class Durations:
    """Durations of evaluations: from `mean_s` (1 - spread) to `mean_s` (1 + spread)."""

    mean_s: float = 0.0
    spread: float = 0.0

    def write(self, place: Location) -> None:
        """Write the durations to a store, creating its folder or bucket."""
        store = open_store(place)
        store.backend.write(store.root / DURATIONS, json.dumps([self.mean_s, self.spread]).encode())

    @staticmethod
    def seconds(store: Store, name: str) -> float:
        """Return the duration of the evaluation with a given digest."""
        mean_s, spread = json.loads(store.backend.read(store.root / DURATIONS))
        return float(mean_s * (1 + spread * (2 * int(name[:8], 16) / 2**32 - 1)))


def prepare(case: Record, store: str) -> Any:
    """Return names only."""
    return {"volume": digest("body", case["reference"]), "mesh": "mesh", "facts": {"tissue_ml": {}}}


def target(case: Record, wanted: Record, store: str) -> Any:
    """Return a name only."""
    return {"target": digest(case, wanted), "kind": "simulated"}


def name_of(
    case: Record, prepared: Record, target: str, constants: Record, score: Record, *free: object
) -> str:
    """Return the digest of an evaluation."""
    return digest(case, prepared, target, constants, score, *free)


def evaluate(request: Record) -> Any:
    """Sleep, then write a record as a simulation would."""
    store, name = open_store(request["store"]), request["digest"]
    seconds = Durations.seconds(store, name)
    time.sleep(seconds)
    constants: Mapping[str, float] = request["constants"]
    apart = math.hypot(*(constants[key] / true - 1 for key, true in TRUTH.items())) + 1e-9
    jc = 1 / (1 + apart)
    score = {"jc": jc, "mhd_mm": apart, "mhd_voxels": apart, "gsf": math.log((1 - jc) * apart)}
    record: Record = {"digest": name, "status": "done", "reason": "", "score": score}
    record |= {"seconds": {"sleep": seconds}, "worker": "", "outcome": {"converged": True}}
    save_evaluation(store, name, record)
    return record | {"reused": False}


def keep_volume(request: Record) -> str:
    """Return the digest, without storing a volume."""
    return str(request["digest"])


def compare(case: Record, store: str, target: str, candidate: str, score: Record) -> Record:
    """Return no scores."""
    return {}


def level(case: Record, prepared: Record, target: str, *where: object) -> Any:
    """Return the same names at any resolution."""
    return {"case": case, "prepared": prepared, "target": target}


def find(request: Record) -> Record:
    """Return no findings."""
    return {}


TASKS = Tasks(prepare, target, evaluate, name_of, keep_volume, compare, level, find)


def text_of(name: str, population: int, generations: int, *, mode: str = "barrier") -> str:
    """Return a study file with a given population and number of generations."""
    return SPEC.format(name=name, population=population, generations=generations, mode=mode)

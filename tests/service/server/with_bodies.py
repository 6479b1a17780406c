"""Stand-ins that also store small bodies for the viewers of a page."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.storage.store import open_store
from palpate.storage.stored_arrays import save_volume
from palpate.storage.values import Tissue, Volume
from tests.recovery import stand_ins

SPACING_MM = 2.0
HALF_AXES_MM = (20.0, 16.0, 12.0)

Record = dict[str, Any]


def egg(stretch: float) -> Volume:
    """Return fat with a central gland on the chest wall, flattened along y by `stretch`."""
    z, y, x = np.mgrid[0:18, -14:15, -16:17] * SPACING_MM
    a, b, c = HALF_AXES_MM[0] * stretch, HALF_AXES_MM[1] / stretch, 2 * HALF_AXES_MM[2]
    far = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
    values = np.where(far < 1, np.where(far < 0.5, Tissue.GLANDULAR, Tissue.FAT), Tissue.AIR)
    return Volume(values.astype(np.uint8), (SPACING_MM,) * 3, (-32.0, -28.0, 0.0))


def prepare(case: Record, store: str) -> Record:
    body = stand_ins.prepare(case, store)
    save_volume(open_store(store), body["volume"], egg(1.0))
    return body


def target(case: Record, wanted: Record, store: str) -> Record:
    record = stand_ins.target(case, wanted, store)
    save_volume(open_store(store), record["target"], egg(1.3))
    return record


def evaluate(request: Record) -> Record:
    record = stand_ins.evaluate(request)
    if record["score"]:
        stretch = 1.3 * math.sqrt(stand_ins.TRUTH["E_fat"] / request["constants"]["E_fat"])
        where = open_store(Path(request["store"]))
        save_volume(where, request["digest"], egg(min(1.5, max(0.9, stretch))))
    return record


TASKS = replace(stand_ins.TASKS, prepare=prepare, target=target, evaluate=evaluate)

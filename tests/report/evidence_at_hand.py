"""Evidence made by hand: two parameters, five evaluations, two of them failures."""

import math
from typing import Any

import numpy as np

from service.chronicle import Session
from service.report.bodies import Bodies
from service.report.evidence import Evidence
from storage.records import EvaluationRecord
from storage.values import Volume

OUTCOME = {
    "converged": True,
    "newton_iterations": [13, 11],
    "cg_iterations": [13, 1391],
    "residual_n": 2.5e-5,
    "plate_displacement_mm": 37.661,
    "plate_force_n": 40.0,
    "contact_area_mm2": 3050.7,
    "penetration_mm": 0.0619,
    "min_j": 0.76972,
    "energy_mj": 471.15,
    "force_imbalance": 1.39e-10,
    "wall_force_n": -0.0021,
    "squeezed": False,
}
SCORE = {"jc": 0.8904, "dice": 0.942, "mhd_mm": 0.39616, "mhd_voxels": 0.19808, "gsf": -3.8299}


def record(candidate: int, genes: tuple[float, float], **ending: Any) -> EvaluationRecord:
    named = {"E_fat_kpa": genes[0], "eta_fat_kpa": genes[1]}
    how: dict[str, Any] = {"status": "done", "score": SCORE, "outcome": OUTCOME} | ending
    if how["status"] != "done":
        how |= {"score": None}
    return EvaluationRecord(candidate, candidate // 4, named, f"d{candidate}", **how)


ENDINGS = (
    record(0, (10.12, 93.0)),
    record(1, (17.0, 150.0), score=SCORE | {"gsf": 0.731}),
    record(2, (5.5, 55.25), status="diverged", reason="element 17 <inverted> at 61 % of the load"),
    record(3, (6.0, 60.0), status="crashed", reason="KeyError: 'x'", traceback="Traceback: <b>"),
    record(4, (12.0, 199.5), score=SCORE | {"gsf": -1.5}, reused=True),
)


def ball(radius: float, shift: int = 0) -> Volume:
    """Fat with a glandular core, on a lattice of 2 mm."""
    z, y, x = np.mgrid[-8:9, -10:11, -12:13]
    r = np.hypot(np.hypot(z, y), x - shift)
    values = np.where(r < 8, 1, 0)
    values[r < radius] = 2
    return Volume(values.astype(np.uint8), (2.0, 2.0, 2.0), (-24.0, -20.0, -16.0))


def results(**changed: Any) -> dict[str, Any]:
    made = {
        "study": "made-by-hand",
        "state": "stopped",
        "stopped": "all 2 generations are done",
        "estimates": {
            "E_fat": {
                "gene": "E_fat_kpa",
                "estimate": 10.12, "target": 10.0, "relative_error": 0.012, "unit": "kPa",
                "bounds": [5.0, 20.0],
            },
            "eta_fat": {
                "gene": "eta_fat_kpa",
                "estimate": 93.0, "target": None, "relative_error": None, "unit": "kPa",
                "bounds": [50.0, 200.0],
            },
        },
        "score": {k: SCORE[k] for k in ("jc", "mhd_mm", "mhd_voxels", "gsf")},
        "evaluations": {"done": 3, "diverged": 1, "crashed": 1, "lost": 0, "reused": 1},
        "generations": [
            {"number": 0, "complete": True, "best": -3.8299, "mean": -1.5495, "failed": 2},
            {"number": 1, "complete": False},
        ],
        "failures": [],
        "per_label_before": {},
        "per_label": {"glandular": SCORE, "fat": SCORE | {"jc": 0.7777}},
        "seconds": 123.0,
        "stages": {
            "solve": {"total": 90.0, "mean": 22.5, "count": 4},
            "score": {"total": 10.0, "mean": 2.5, "count": 4},
        },
        "facts": {"voxels": 55704, "spacing_mm": [2.0, 2.0, 2.0], "volume_ml": 445.632,
                  "glandular_fraction": 0.2, "nodes": 916, "tets": 3744, "levels": [166, 916],
                  "element_size_mm": 11.58},
        "versions": {"palpate": "0.1.0", "numpy": "2.4.6"},
        "config": {"name": "made-by-hand"},
    }  # fmt: skip
    return made | changed


SPEC: dict[str, Any] = {
    "name": "made-by-hand",
    "score": {"labels": ["glandular"], "surface": "boundary"},
    "search": {"population": 4, "elite": 1, "parameters": {"E_fat_kpa": [5.0, 20.0]}},
}
SESSION = Session("2026-01-01T00:00:00+00:00", "/nowhere", {}, {}, {}, 3, 1.0)
BODIES = Bodies(ball(3), ball(5, 1), ball(5, 2))


def evidence(**changed: Any) -> Evidence:
    parts: dict[str, Any] = {
        "results": results(),
        "spec": SPEC,
        "endings": ENDINGS,
        "best": ENDINGS[0],
        "session": SESSION,
        "bodies": BODIES,
    }
    return Evidence(**(parts | changed))


def nothing_yet() -> Evidence:
    """A study whose first evaluation has not ended."""
    none = dict.fromkeys(("jc", "mhd_mm", "mhd_voxels", "gsf"))
    empty = results(
        state="running", stopped=None, score=none, generations=[], per_label={}, stages={},
        evaluations=dict.fromkeys(("done", "diverged", "crashed", "lost", "reused"), 0),
        facts={}, seconds=0.0,
    )  # fmt: skip
    for found in empty["estimates"].values():
        found |= {"estimate": None, "relative_error": None}
    return evidence(results=empty, endings=(), best=None, session=None, bodies=Bodies())


def perfect() -> Evidence:
    """The best candidate is the target itself; a whole generation has failed before."""
    best = record(0, (10.12, 93.0), score=SCORE | {"jc": 1.0, "mhd_mm": 0.0, "gsf": -math.inf})
    found = results(
        score={"jc": 1.0, "mhd_mm": 0.0, "mhd_voxels": 0.0, "gsf": -math.inf},
        generations=[
            {"number": 0, "complete": True, "best": math.inf, "mean": None, "failed": 4},
            {"number": 1, "complete": True, "best": -math.inf, "mean": -1.5, "failed": 0},
        ],
    )
    return evidence(results=found, endings=(best, *ENDINGS[2:]), best=best)

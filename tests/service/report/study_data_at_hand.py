"""Hand-made study data: two parameters, five evaluations, two of them failures."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.report.study.study_data import Bodies, StudyData
from palpate.service.results.result_records import (
    EvaluationCounts,
    GenerationResult,
    GenerationScores,
    ParameterEstimate,
    StageTime,
    StudyResults,
)
from palpate.service.study.study_keys import parse_spec
from palpate.storage.journal_records import EvaluationRecord, SessionRecord
from palpate.storage.values import Volume
from palpate.workers.organs.breast.breast_organ import score_by_tissue

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
    """Return fat with a glandular core, on a lattice of 2 mm."""
    z, y, x = np.mgrid[-8:9, -10:11, -12:13]
    r = np.hypot(np.hypot(z, y), x - shift)
    values = np.where(r < 8, 1, 0)
    values[r < radius] = 2
    return Volume(values.astype(np.uint8), (2.0, 2.0, 2.0), (-24.0, -20.0, -16.0))


STUDY = """
name: made-by-hand
case: {reference: {phantom: {preset: 445ml}}}
target: {constants: {E_fat_kpa: 10}}
score: {labels: [glandular], surface: boundary}
search:
  population: 4
  elite: 1
  parameters: {E_fat_kpa: [5, 20], eta_fat_kpa: [50, 200]}
"""


def results(**changed: Any) -> StudyResults:
    parts: dict[str, Any] = {
        "folder": Path("/nowhere/runs/made-by-hand"),
        "spec": parse_spec(STUDY, "the test's study", Path()),
        "state": "stopped",
        "stop_reason": "all 2 generations are done",
        "estimates": {
            "E_fat": ParameterEstimate("E_fat_kpa", "kPa", 5.0, 20.0, 10.12, 10.0),
            "eta_fat": ParameterEstimate("eta_fat_kpa", "kPa", 50.0, 200.0, 93.0, None),
        },
        "best": ENDINGS[0],
        "counts": EvaluationCounts(done=3, diverged=1, crashed=1, lost=0, reused=1),
        "generations": (
            GenerationResult(0, 4, 4, GenerationScores(-3.8299, -1.5495, 0, {}, 2)),
            GenerationResult(1, 3, 1, None),
        ),
        "failures": (),
        "undeformed_scores": {},
        "best_scores": {"glandular": SCORE, "fat": SCORE | {"jc": 0.7777}},
        "wall_s": 123.0,
        "stages": {"solve": StageTime(90.0, 22.5, 4), "score": StageTime(10.0, 2.5, 4)},
        "body_facts": {
            "voxels": 55704,
            "spacing_mm": [2.0, 2.0, 2.0],
            "volume_ml": 445.632,
            "glandular_fraction": 0.2,
            "nodes": 916,
            "tets": 3744,
            "levels": [166, 916],
            "element_size_mm": 11.58,
        },
        "target_kind": "image",
        "sessions": 1,
        "versions": {"palpate": "0.1.0", "numpy": "2.4.6"},
        "store": None,
        "findings": {},
    }
    return StudyResults(**(parts | changed))


PREPARED: Any = {"volume": None, "mesh": None, "facts": {}}
TARGET: Any = {"target": None, "kind": "image"}
SESSION = SessionRecord("2026-01-01T00:00:00+00:00", "/nowhere", {}, PREPARED, TARGET, 3, 1.0)
UNDEFORMED, TARGET_BODY, BEST = ball(3), ball(5, 1), ball(5, 2)
BODIES = Bodies(
    UNDEFORMED,
    TARGET_BODY,
    BEST,
    scores_before=score_by_tissue(TARGET_BODY, UNDEFORMED),
    scores_after=score_by_tissue(TARGET_BODY, BEST),
)


def study_data(**changed: Any) -> StudyData:
    parts: dict[str, Any] = {
        "results": results(),
        "endings": ENDINGS,
        "sessions": (SESSION,),
        "bodies": BODIES,
    }
    return StudyData(**(parts | changed))


def nothing_yet() -> StudyData:
    """Return a study before the end of its first evaluation."""
    without = {
        name: replace(estimate, estimate=None) for name, estimate in results().estimates.items()
    }
    empty = results(
        state="running",
        stop_reason=None,
        estimates=without,
        best=None,
        counts=EvaluationCounts(0, 0, 0, 0, 0),
        generations=(),
        best_scores={},
        wall_s=0.0,
        stages={},
        body_facts={},
    )
    return study_data(results=empty, endings=(), sessions=(), bodies=Bodies())


def perfect() -> StudyData:
    """Return a study with the target as best candidate, after a failed generation."""
    best = record(0, (10.12, 93.0), score=SCORE | {"jc": 1.0, "mhd_mm": 0.0, "gsf": -math.inf})
    changed = results(
        best=best,
        generations=(
            GenerationResult(0, 4, 4, GenerationScores(math.inf, None, 0, {}, 4)),
            GenerationResult(1, 3, 3, GenerationScores(-math.inf, -1.5, 4, {}, 0)),
        ),
    )
    return study_data(results=changed, endings=(best, *ENDINGS[2:]))

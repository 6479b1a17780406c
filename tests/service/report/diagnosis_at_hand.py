"""Hand-made diagnoses, one for each verdict: four points, two scans, three effects."""

from typing import Any

import numpy as np

from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.storage.json_digests import from_json
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary

Json = dict[str, Any]
SCANS = ("40 N", "80 N")


def gap(middle: float, low: float, high: float) -> Json:
    return {"gap_mm": middle, "low_mm": low, "high_mm": high, "noise_mm": 0.44, "points": 8}


def effect(
    name: str,
    family: str,
    gain: float | None,
    absorbed: float,
    *parameters: Json,
    seen_from: float | None = None,
) -> Json:
    lead = parameters[0]
    seen = {} if seen_from is None else {"seen_from": seen_from}
    return {
        "name": name,
        "family": family,
        "summary": f"What {name} <is>.",
        "gain": gain,
        "magnitude": lead["magnitude"],
        "sd": lead["sd"],
        "unit": lead["unit"],
        "parameters": list(parameters),
        "log_bayes_factor": 12.34,
        "absorbed_share": absorbed,
        "refitted": gain is not None,
        "seen_unit": "" if seen_from is None else lead["unit"],
    } | seen


def parameter(name: str, magnitude: float, sd: float, unit: str) -> Json:
    return {"parameter": name, "magnitude": magnitude, "sd": sd, "unit": unit}


EFFECTS = [
    effect("plate_force", "loading", None, 0.993, parameter("ln_force", 0.1, 0.14, "")),
    effect(
        "plate_flex",
        "plate geometry",
        95.0,
        0.05,
        parameter("flex_depth_mm", 8.0, 1.04, "mm"),
        seen_from=2.04,
    ),
    effect(
        "plate_tilt",
        "plate geometry",
        127.24,
        0.01,
        parameter("tilt_depth_deg", 5.4838, 0.2712, "deg"),
        parameter("tilt_across_deg", -0.036, 0.12, "deg"),
        seen_from=1.27,
    ),
]

WHERE = [
    {
        "scan": "40 N",
        "interface": "outline",
        "region": "all",
        "signed_mean_mm": -0.0004,
        "significant": False,
    }
    | gap(0.1, 0.0, 0.2),
    {
        "scan": "80 N",
        "interface": "glandular",
        "region": "nipple third",
        "signed_mean_mm": -0.254,
        "significant": True,
    }
    | gap(0.612, 0.51, 0.7),
]


def summary(**changes: Any) -> Json:
    """Return the summary of a tilted plate."""
    held = {
        "before": gap(0.314, 0.269, 0.353),
        "after": gap(0.0, 0.0, 0.154),
        "share": {"share": 1.0, "low": 0.77, "high": 1.0},
    }
    told = {
        "case": "by-hand",
        "verdict": "effect",
        "primary": ["plate_tilt"],
        "effects": EFFECTS,
        "rivals": [],
        "absorbed": ["plate_force"],
        "gain": 127.24,
        "left_gain": -0.99,
        "something_else": False,
        "gap_mm": {
            "before": gap(0.2684, 0.2256, 0.3053),
            "after": gap(0.05, 0.0, 0.1206),
            "share": {"share": 0.97, "low": 0.76, "high": 1.0},
            "noise_floor": 0.4367,
            "calibration_floor": 0.05,
            "held_out_before": held["before"],
            "held_out_after": held["after"],
            "held_out_share": held["share"],
            "held_out": "each scan judged by a fit to the others",
            "held_out_each": {"40 N": held, "80 N": held},
            "not_judged": [],
        },
        "where": WHERE,
        "constants": {
            "E_fat_kpa": {
                "before": 10.0,
                "after": 11.0,
                "before_interval": [9.8, 10.2],
                "after_interval": [10.7, 11.3],
                "stated": [5.0, 20.0],
            },
            "eta_kpa": {
                "before": 54.45,
                "after": 60.11,
                "before_interval": [50.0, 58.0],
                "after_interval": [55.0, 66.0],
                "stated": [30.0, 120.0],
            },
        },
        "refits": [
            {
                "effects": ["plate_flex"],
                "log_evidence_gain": 95.0,
                "field_gain": None,
                "converged": True,
                "values": {},
            },
            {
                "effects": ["plate_tilt"],
                "log_evidence_gain": 127.24,
                "field_gain": -0.99,
                "converged": True,
                "values": {},
            },
            {
                "effects": ["plate_tilt", "plate_flex"],
                "log_evidence_gain": 124.4,
                "field_gain": None,
                "converged": True,
                "values": {},
            },
        ],
        "points": 4,
    }
    return told | changes


def nothing(kind: str, **changes: Any) -> Json:
    """Return a summary that names no effect."""
    alone = {
        "before": gap(0.03, 0.0, 0.11),
        "noise_floor": 0.4367,
        "calibration_floor": 0.05,
        "after": None,
        "held_out_before": None,
        "held_out_after": None,
        "not_judged": [],
    }
    constants = {"E_fat_kpa": {"before": 10.0, "after": None, "before_interval": [9.8, 10.2]}}
    told = {
        "verdict": kind,
        "primary": [],
        "effects": [one | {"gain": None, "refitted": False} for one in EFFECTS],
        "gain": 0.0,
        "gap_mm": alone,
        "refits": [],
        "constants": constants,
    }
    return summary(**told | changes)


def typed(told: Json) -> Summary:
    """Return a summary from its JSON."""
    return from_json(Summary, told)


def found(told: Json | None = None) -> FinishedDiagnosis:
    told = summary() if told is None else told
    rng = np.random.default_rng(3)
    maps = {
        "points": np.array([[10.0 * i, (-1.0) ** i * 5 * i, 3.0 + i] for i in range(12)]),
        "interface": np.repeat(np.array([0, 1], np.int32), 6),
        "before": rng.normal(0, 1.0, (2, 12)),
        "noise": np.full((2, 12), 0.4),
    }
    if told["primary"]:
        maps["after"] = rng.normal(0, 0.4, (2, 12))
    return FinishedDiagnosis(typed(told), maps, SCANS)


VERDICTS = {
    "effect": summary(),
    "no gap": nothing("no-gap"),
    "none of these": nothing("none-of-these", left_gain=41.23, something_else=True),
    "not told apart": summary(
        verdict="cannot-be-told-apart",
        rivals=["plate_tilt", "plate_flex"],
        effects=[
            *(one for one in EFFECTS if one["name"] != "plate_flex"),
            *(one | {"gain": 124.0} for one in EFFECTS if one["name"] == "plate_flex"),
        ],
    ),
    "one scan": summary(
        gap_mm={
            "before": gap(0.3, 0.2, 0.4),
            "after": gap(0.1, 0.0, 0.2),
            "noise_floor": 0.44,
            "calibration_floor": 0.05,
            "share": {"share": 0.9, "low": 0.5, "high": 1.0},
            "held_out_before": None,
            "held_out_after": None,
            "held_out": "one scan only",
            "not_judged": [],
        }
    ),
}

"""A diagnosis as plain numbers: what `palpate diagnose --json` prints."""

from typing import Any

import numpy as np

from storage.values import BoolArray, FloatArray
from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.gap import Gap, LinearFit, gap
from workers.diagnosis.linear import Linearised
from workers.diagnosis.shrinkage import shrinkage, unseen_shrinkage
from workers.diagnosis.subject import Subject
from workers.effects.base import Effect, one_sided
from workers.effects.inclusion import INCLUSION

Json = dict[str, Any]
INTERFACES = ("outline", "glandular")
SEED = 0
# Gap that a mesh from a noisy segmentation opens, in standard deviations of the noise.
DRAWN_NOISES = 0.17
# A region is significant if its interval does not reach down to this, in mm.
NOTHING_MM = 1e-9


def summary(found: Diagnosis, effects: list[Effect], case: str) -> Json:
    """The contract of the command.

    Parameters
    ----------
    found : Diagnosis
    effects : list of Effect
        The catalogue.
    case : str
        Its name.
    """
    said, seen = found.verdict, found.look
    return {
        "case": case,
        "verdict": said.kind,
        "primary": list(said.primary),
        "effects": [_effect(found, e) for e in effects if e.name in seen.prints],
        "set90": list(said.set90),
        "families": said.families,
        "absorbed": list(said.hidden),
        "no_gap_probability": said.no_gap,
        "none_of_these_probability": said.none_of_these,
        "alarm": said.alarm,
        "threshold": said.threshold,
        "explained_share": said.explained_share,
        "gap_mm": _gap_mm(found),
        "where": _where(found),
        "constants": _constants(found),
        "refits": [_refit(found, names) for names in found.refits],
        "points": len(seen.subject.points),
    }


def _effect(found: Diagnosis, effect: Effect) -> Json:
    finding = found.look.by_name[effect.name]
    best = found.best
    names = best.names if best is not None and effect.name in best.names else (effect.name,)
    refit = found.refits.get(names)
    magnitudes: list[Json] = []
    for i, parameter in enumerate(effect.parameters):
        if refit is not None:
            at = refit.fit.unknowns.names.index(parameter.name)
            value, sd = float(refit.fit.z[at]), float(_sds(found, names)[at])
        elif i < len(finding.estimate):
            value, sd = float(finding.estimate[i]), float(finding.estimate_sd[i])
            if one_sided(parameter):
                value = max(value, effect.neutral[parameter.name])
        else:
            continue
        unit = parameter.unit
        magnitudes.append(
            {
                "parameter": parameter.door_name,
                "magnitude": unit.to_door(value),
                "sd": unit.to_door(sd),
                "unit": unit.symbol,
            }
        )
    lead = magnitudes[0] if effect is INCLUSION else max(magnitudes, key=_standing_out)
    return {
        "name": effect.name,
        "family": effect.family,
        "summary": effect.summary,
        "probability": found.verdict.probabilities.get(effect.name, 0.0),
        "magnitude": lead["magnitude"],
        "sd": lead["sd"],
        "unit": lead["unit"],
        "parameters": magnitudes,
        "log_bayes_factor": finding.log_bayes_factor,
        "absorbed_share": finding.absorbed,
        "refitted": refit is not None,
    }


def _standing_out(parameter: Json) -> float:
    return abs(float(parameter["magnitude"])) / max(float(parameter["sd"]), 1e-12)


def _sds(found: Diagnosis, names: tuple[str, ...]) -> FloatArray:
    refit = found.refits[names]
    at = refit.fit.linearised(found.look.subject)
    A = at.scaled_nominal
    spread = np.sqrt(np.diag(np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)))
    return np.asarray(spread * at.nominal_sd)


def _gap_mm(found: Diagnosis) -> Json:
    subject, nominal = found.look.subject, found.look.linear
    floor_mm = _floor_mm(subject, nominal)
    before = gap(LinearFit(nominal), floor_mm=floor_mm)
    out: Json = {
        "before": _as_json(before),
        "noise_floor": before.noise_mm,
        "calibration_floor": floor_mm,
    }
    refit = found.best
    if refit is None:
        return out | {"after": None, "held_out_before": None, "held_out_after": None}
    with_effect = refit.fit.linearised(subject)
    inside = shrinkage(nominal, with_effect, SEED, floor_mm=floor_mm)
    out |= {
        "before": _as_json(inside.before),
        "after": _as_json(inside.after),
        "share": _share(inside),
    }
    held = _held_out(subject, nominal, with_effect, floor_mm)
    return out | held


def _floor_mm(subject: Subject, nominal: Linearised) -> float:
    """What even the right model misses; without it, gaps near zero come out too small.

    The noise that was fitted; what the mesh leaves, as large as what a finer one has taken
    off; and that the body is meshed as it was segmented.
    """
    mesh = float(np.sqrt((subject.bias**2).mean()))
    drawn = DRAWN_NOISES * subject.noise.reference_sd_mm
    return float(np.linalg.norm([LinearFit(nominal).floor_mm, mesh, drawn]))


def _held_out(
    subject: Subject, nominal: Linearised, with_effect: Linearised, floor_mm: float
) -> Json:
    """Each scan judged by a fit to the others."""
    if len(subject.scans) < 2:
        return {"held_out_before": None, "held_out_after": None, "held_out": "one scan only"}
    whole = unseen_shrinkage(nominal, with_effect, subject.rows, SEED, floor_mm)
    each = {}
    for number, scan in enumerate(subject.scans):
        judge: BoolArray = subject.rows == number
        found = shrinkage(nominal, with_effect, SEED, ~judge, judge, floor_mm)
        each[scan.name] = {"before": _as_json(found.before), "after": _as_json(found.after),
                           "share": _share(found)}  # fmt: skip
    return {
        "held_out_before": _as_json(whole.before),
        "held_out_after": _as_json(whole.after),
        "held_out_share": _share(whole),
        "held_out": "each scan judged by a fit to the others",
        "held_out_each": each,
    }


def _where(found: Diagnosis) -> list[Json]:
    subject = found.look.subject
    fit = LinearFit(found.look.linear)
    regions = []
    own = np.tile(subject.points.interface, len(subject.scans))
    z = np.tile(subject.frame.normalised(subject.points.points)[:, 2], len(subject.scans))
    depth = {"chest wall third": z < -1 / 3, "middle third": abs(z) <= 1 / 3,
             "nipple third": z > 1 / 3}  # fmt: skip
    for number, scan in enumerate(subject.scans):
        for interface, name in enumerate(INTERFACES):
            rows = (subject.rows == number) & (own == interface)
            places = {"all": np.ones(len(rows), bool)} | depth
            for place, inside in places.items():
                chosen = rows & inside
                if chosen.sum() >= 8:
                    found_gap = gap(fit, chosen)
                    regions.append(
                        {"scan": scan.name, "interface": name, "region": place}
                        | _as_json(found_gap)
                        | {
                            "signed_mean_mm": float(fit.residual[chosen].mean()),
                            "p50_mm": float(np.quantile(np.abs(fit.residual[chosen]), 0.5)),
                            "p95_mm": float(np.quantile(np.abs(fit.residual[chosen]), 0.95)),
                            "significant": bool(found_gap.low_mm > NOTHING_MM),
                        }
                    )
    return regions


def _constants(found: Diagnosis) -> Json:
    out: Json = {}
    before = found.look.nominal.values()
    after = found.best.fit.values() if found.best is not None else {}
    for free in found.look.subject.free:
        out[f"{free.name}_kpa"] = {
            "before": 1e3 * before[free.name],
            "after": 1e3 * after[free.name] if free.name in after else None,
        }
    return out


def _refit(found: Diagnosis, names: tuple[str, ...]) -> Json:
    hypothesis = next(h for h in found.hypotheses if h.effects == names)
    nothing = next(h for h in found.hypotheses if not h.effects)
    refit = found.refits[names]
    return {
        "effects": list(names),
        "log_evidence_gain": hypothesis.log_evidence - nothing.log_evidence,
        "field_gain": hypothesis.discrepancy_gain,
        "converged": refit.fit.converged,
        "values": refit.fit.values(),
    }


def _as_json(g: Gap) -> Json:
    return {"gap_mm": g.gap_mm, "low_mm": g.low_mm, "high_mm": g.high_mm, "noise_mm": g.noise_mm,
            "points": g.points}  # fmt: skip


def _share(s: Any) -> Json:
    return {"share": s.share, "low": s.low, "high": s.high}

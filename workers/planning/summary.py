"""A plan as plain numbers: what `palpate plan --json` prints."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.detectability import SUNK
from workers.diagnosis.subject import Subject
from workers.effects.base import Effect
from workers.fem.loads import ForceControl
from workers.planning.acquisition import State
from workers.planning.designs import (
    CLEAR,
    PLATES_SD_MM,
    STIFFNESS_SD,
    Design,
    Outlook,
    loose,
    outlook,
    plausible,
    simulated,
)
from workers.planning.foreseen import Foreseen

Json = dict[str, Any]


def plan(
    name: str,
    ground: Subject,
    states: Sequence[State],
    foreseen: Mapping[int, Foreseen],
    effects: Sequence[Effect],
) -> Json:
    """What the meant loads can tell, and what else would tell more, the best first.

    Parameters
    ----------
    name : str
        Of the case.
    ground : Subject
        See `workers.planning.foreseen.ground_of`.
    states : sequence of State
        See `workers.planning.acquisition.states_of`.
    foreseen : mapping of int to Foreseen
        By the number of the state; states that cannot be simulated are missing.
    effects : sequence of Effect
        The catalogue.
    """
    present = tuple(n for n in foreseen if states[n].kind == "meant")
    acting = simulated([foreseen[n] for n in present], effects)
    now = outlook(ground, Design(present), foreseen, acting)
    shown = frozenset(row.name for row in now.rows if row.absorbed <= SUNK)
    found = []
    for option, design in designs(ground, states, foreseen).items():
        known = simulated([foreseen[n] for n in design.states], acting)
        then = outlook(ground, design, foreseen, known)
        found.append(_acquisition(option, now, replace(then, shown=shown)))
    return {
        "case": name,
        "scans": [states[n].name for n in present],
        "points": len(ground.points),
        "noise_mm": ground.noise.sd_mm,
        "travel_mm": {states[n].name: part.travel_mm for n, part in foreseen.items()},
        "clear": CLEAR,
        "effects": [_effect(e, now, i) for i, e in enumerate(acting)],
        "cosines": now.cosines.tolist(),
        "log_evidence": now.separation.tolist(),
        "pairs": len(acting) * (len(acting) - 1) // 2,
        "told_apart": len(now.apart()),
        "confusable": _confusable(now),
        "silent": [n for n, seen in zip(now.names, now.seen, strict=True) if not seen],
        "not_simulated": [s.name for n, s in enumerate(states) if n not in foreseen],
        "loose": [e.name for e in loose([foreseen[n] for n in present], acting)],
        "without_columns": [e.name for e in effects if e not in acting],
        "acquisitions": sorted(found, key=_rank),
    }


def designs(
    ground: Subject, states: Sequence[State], foreseen: Mapping[int, Foreseen]
) -> dict[str, Design]:
    """What could be scanned or measured besides the meant loads, by its words."""
    present = tuple(n for n in foreseen if states[n].kind == "meant")
    found = {
        ("a scan at " if states[n].kind == "load" else "a view, ") + states[n].name: Design(
            (*present, n)
        )
        for n in foreseen
        if n not in present
    }
    found["a second segmentation of every scan"] = Design(present, drawings=2)
    middle = {f.name: float(np.exp(f.log_mean)) for f in ground.free}
    if any(isinstance(states[n].problem(middle).load, ForceControl) for n in present):
        found[f"the plates' distance to {PLATES_SD_MM:g} mm"] = Design(present, plates=True)
    for number, free in enumerate(ground.free):
        if free.name.startswith("E_"):
            words = f"{free.name} measured apart to {100 * STIFFNESS_SD:.0f} %"
            found[words] = Design(present, known=number)
            break
    return found


def _effect(effect: Effect, now: Outlook, i: int) -> Json:
    row = now.rows[i]
    sizes = plausible(effect)
    parameters = [
        {
            "parameter": p.door_name,
            "unit": p.unit.symbol,
            "minimum": p.unit.to_door(float(least)) if np.isfinite(least) else None,
            "plausible": p.unit.to_door(sd),
        }
        for p, least, sd in zip(effect.parameters, row.minimum, sizes, strict=False)
    ]
    return {
        "name": effect.name,
        "family": effect.family,
        "summary": effect.summary,
        "parameters": parameters,
        "absorbed_share": row.absorbed,
        "nearest": row.nearest,
        "cosine": row.cosine,
        "log_evidence": float(now.evidence[i]),
        "seen": bool(now.seen[i]),
        "why_not": "hidden" if now.hidden[i] else "" if now.seen[i] else "weak",
    }


def _confusable(now: Outlook) -> list[Json]:
    """Pairs that are seen and not told apart, the most alike first."""
    worst = sorted(now.pairs().items(), key=lambda item: item[1])
    order = now.names.index
    return [
        {"effects": sorted(pair, key=order), "log_evidence": value}
        for pair, value in worst
        if value < CLEAR
    ]


def _acquisition(name: str, now: Outlook, then: Outlook) -> Json:
    """What a design adds; effects that cannot be simulated in it are left out of both sides."""
    order = now.names.index
    known = set(then.names)
    before = {pair for pair in now.apart() if pair <= known}
    more = len(then.apart()) - len(before)
    confusable = {frozenset(c["effects"]) for c in _confusable(now)}
    rows = {row.name: row for row in now.rows}
    seen = dict(zip(now.names, now.seen, strict=True))
    ratios = {row.name: _ratio(rows[row.name].minimum, row.minimum) for row in then.rows}
    found = list(zip(then.names, then.seen, strict=True))
    return {
        "name": name,
        "told_apart": len(now.apart()) + more,
        "more_told_apart": more,
        "separates": sorted(sorted(pair, key=order) for pair in confusable & then.apart()),
        "reveals": [n for n, shown in found if shown and not seen[n]],
        "silent": [n for n, shown in found if not shown],
        "minimum_ratio": float(np.exp(np.mean(np.log(list(ratios.values()))))),
        "minimum_ratios": ratios,
        "absorbed_shares": {row.name: row.absorbed for row in then.rows},
        "not_simulated": [n for n in now.names if n not in known],
    }


def _ratio(before: FloatArray, after: FloatArray) -> float:
    """Of what must be there to be found, after over before; geometric mean of the parameters."""
    both = np.isfinite(before) & np.isfinite(after)
    return float(np.exp(np.mean(np.log(after[both] / before[both])))) if both.any() else 1.0


def _rank(acquisition: Json) -> tuple[int, int, float, str]:
    return (
        -acquisition["more_told_apart"],
        -len(acquisition["separates"]),
        acquisition["minimum_ratio"],
        acquisition["name"],
    )

"""Converts true magnitudes to the catalogue's parameters, to compare estimates with them.

Whoever made a case gave each cause a form of its own; `Effect.truth` returns the parameters of the
same meaning in the catalogue, which a diagnosis should find.
"""

import math
from collections.abc import Mapping

import numpy as np

from palpate.service.blind.sealed.records import Magnitude
from palpate.service.blind.sealed.truth import CATALOGUE, MAPPED, Truth
from palpate.storage.values import Triple
from palpate.workers.diagnosis.schema.summary import EffectSummary


def true_values(truth: Truth) -> dict[str, float]:
    """Return parameters of the catalogue under their door names, of all true effects.

    Raises
    ------
    KeyError
        If a cause lacks a parameter.
    """
    convert = {e.name: e.truth for e in CATALOGUE.effects if e.truth is not None}
    out: dict[str, float] = {}
    for cause in truth.causes:
        if cause.effect in convert:
            out |= convert[cause.effect](cause.parameters)
    return out


def magnitudes(truth: Truth, by_name: Mapping[str, EffectSummary]) -> list[Magnitude]:
    """Put found beside true magnitudes, of a single effect that was refitted.

    Parameters
    ----------
    by_name : mapping of str to EffectSummary
        What is said of each effect, see `workers.diagnosis.schema.summary`.
    """
    found = by_name.get(truth.effects[0]) if truth.group == "single" else None
    if found is None or not found.refitted:
        return []
    true = true_values(truth)
    return [
        Magnitude(p.parameter, p.magnitude, p.sd, true[p.parameter])
        for p in found.parameters
        if p.parameter in true
    ]


def strength(truth: Truth, by_name: Mapping[str, EffectSummary]) -> float | None:
    """Return the true size of a single effect in the standard deviations of its estimate.

    What the scans could tell of it at most, to someone who knows its form: s^2 / 2 nats against
    no gap. None where the catalogue has no parameter of the same meaning, and where an effect does
    not grow in proportion to its size: friction, springs and lumps tire, and that they act is known
    better than how much; the edge of a plate does ever more.

    Parameters
    ----------
    by_name : mapping of str to EffectSummary
    """
    found = by_name.get(truth.effects[0]) if len(truth.causes) == len(truth.effects) == 1 else None
    if found is None or not CATALOGUE.named(found.name).is_proportional:
        return None
    true = true_values(truth)
    sizes = [true[p.parameter] / p.sd for p in found.parameters if p.parameter in true and p.sd > 0]
    return math.hypot(*sizes) if sizes else None


def lump_apart_mm(
    truth: Truth, by_name: Mapping[str, EffectSummary], centre_mm: Triple | None
) -> float | None:
    """Return the distance of the true and the found centre of a lump; None unless both are there.

    Parameters
    ----------
    centre_mm : tuple of float or None
        Middle of the body: answers of earlier versions hold offsets from it.
    """
    given = next((c.parameters for c in truth.causes if c.effect == MAPPED.name), None)
    found = by_name.get(MAPPED.name)
    if given is None or found is None or not found.refitted or MAPPED.place is None:
        return None
    sizes = {p.parameter: p.magnitude for p in found.parameters}
    positions = [name for name, _ in MAPPED.place.positions_mm((0.0, 0.0, 0.0)).values()]
    if positions[0] in sizes:
        at = np.array([sizes[name] for name in positions])
    elif centre_mm is None:
        return None
    else:
        at = np.add(centre_mm, [sizes[f"{name}_mm"] for name in MAPPED.place.offsets])
    return float(np.linalg.norm(at - np.asarray(given["centre_mm"])))

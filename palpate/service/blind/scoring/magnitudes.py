"""Conversion of true magnitudes to the catalogue's parameters, for comparison with estimates.

The maker of a case parametrises each cause in its own way; `Effect.truth` returns the catalogue
parameters with the same meaning, which a diagnosis should find.
"""

import math
from collections.abc import Mapping

import numpy as np

from palpate.service.blind.sealed.records import Magnitude
from palpate.service.blind.sealed.truth import CATALOGUE, MAPPED, Truth
from palpate.storage.values import Triple
from palpate.workers.diagnosis.schema.summary import EffectSummary


def true_values(truth: Truth) -> dict[str, float]:
    """Return the catalogue parameters of all true effects, under their external names.

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
    """Return estimated and true magnitudes of a single effect that was refitted.

    Parameters
    ----------
    by_name : mapping of str to EffectSummary
        The summary of each effect, see `workers.diagnosis.schema.summary`.
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
    """Return the true size of a single effect in standard deviations of its estimate.

    It bounds the evidence in the scans, given the form of the effect: s^2 / 2 nats against no
    gap. None if the catalogue has no parameter with the same meaning, or if the response is not
    proportional to the size: friction, springs and lumps saturate, so their presence is better
    known than their size; the effect of a plate edge grows faster than its size.

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
    """Return the distance between the true and the estimated centre of a lump, or None.

    Parameters
    ----------
    centre_mm : tuple of float or None
        Middle of the body, from which answers of earlier versions measure offsets.
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

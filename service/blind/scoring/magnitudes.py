"""Converts true magnitudes to the catalogue's parameters, to compare estimates with them.

Whoever made a case gave each cause a form of its own; where the catalogue has a parameter of
the same meaning, that is what the diagnosis should find:

========================  ==============================================================
tilt, friction, gravity,  the same quantities under other names
chest wall, skin, labels,
scale of the image
fibres                    an angle and its direction, as turns towards x and y
gradient                  ln of the stiffness at the faces of the body (a tanh, not a line)
lump                      ln of the ratio; the radius of the ball of equal volume; its centre
                          in the frame of the scan
stiffening                c2 / mu = b / 4: Fung's law mu / (2 b) (exp(b (I1 - 3)) - 1) has the
                          second term mu b / 4 (I1 - 3)^2
fibres of the gland       ln of the ratio in the middle of the body
swelling                  ln of the volume of the gland; fat has not grown
plates' edge              half a millimetre behind where the plate begins to press
scar, tether              the springs per area; of a disc of radius R, which a scar has, the
                          radius R / sqrt(2) of the bell with as much stiffness in total
force                     ln of the force that the body carries over the stated one
========================  ==============================================================
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palpate.service.blind.sealed.records import Magnitude
from palpate.service.blind.sealed.truth import Truth
from palpate.storage.values import Triple
from palpate.workers.diagnosis.schema.summary import EffectSummary
from palpate.workers.mechanics.effects.base import one_sided
from palpate.workers.mechanics.effects.breast_catalogue import BREAST_EFFECTS
from palpate.workers.mechanics.effects.local_stiffness import INCLUSION, PLACE

Given = Mapping[str, Any]
SCALES = ("scale_x", "scale_y", "scale_z")
# The pressure of a blind plate rises over 4 mm, and a penalty needs little of it: bodies made with
# edges at 5 mm feel them at 5.5 and 5.7 mm.
EDGE_FELT_MM = 0.5


def _renamed(**names: str) -> Callable[[Given], dict[str, float]]:
    """Return parameters of the catalogue that have another name in the truth."""
    return lambda given: {ours: float(given[theirs]) for ours, theirs in names.items()}


def _fibres(given: Given) -> dict[str, float]:
    turn, azimuth = given["turn_deg"], math.radians(given["azimuth_deg"])
    return {
        "fibre_turn_x_deg": turn * math.cos(azimuth),
        "fibre_turn_y_deg": turn * math.sin(azimuth),
    }


def _lump(given: Given) -> dict[str, float]:
    ratio = math.log(given["ratio"])
    return {"inclusion_ln_ratio": ratio, "inclusion_radius_mm": given["radius_mm"]}


def _swelling(given: Given) -> dict[str, float]:
    return {"ln_growth_fat": 0.0, "ln_growth_glandular": math.log1p(given["volume_fraction"])}


def _attachment(given: Given) -> dict[str, float]:
    """Return the springs along all axes of a tether, along the chest wall of a scar."""
    is_scar = "radius_mm" in given
    grip, axes = float(given["grip_kpa_per_mm"]), "xy" if is_scar else "xyz"
    springs = {f"attachment_stiffness_{axis}_kpa_per_mm": grip for axis in axes}
    bell = {"attachment_radius_mm": given["radius_mm"] / math.sqrt(2)} if is_scar else {}
    return springs | bell


def _edge(given: Given) -> dict[str, float]:
    return {"plate_edge_mm": given["edge_mm"] + EDGE_FELT_MM}


def _scale(given: Given) -> dict[str, float]:
    return dict(zip(SCALES, given["scale"], strict=True))


def _force(given: Given) -> dict[str, float]:
    return {"ln_plate_force": math.log(given["factor"])}


# Effects that do not grow in proportion to their size: those at one place, or from zero.
NOT_PROPORTIONAL = {
    e.name for e in BREAST_EFFECTS if e.place is not None or any(one_sided(p) for p in e.parameters)
}

IN_CATALOGUE: dict[str, Callable[[Given], dict[str, float]]] = {
    "plate_force": _force,
    "gravity_change": _renamed(gravity_x_g="x_g", gravity_y_g="y_g", gravity_z_g="z_g"),
    "plate_tilt": _renamed(tilt_depth_deg="depth_deg", tilt_across_deg="across_deg"),
    "plate_edge": _edge,
    "plate_friction": _renamed(friction="coefficient"),
    "wall_compliance": _renamed(wall_compliance_mm_per_kpa="compliance_mm_per_kpa"),
    "stiffness_gradient": _renamed(
        ln_gradient_x="ln_x", ln_gradient_y="ln_y", ln_gradient_z="ln_z"
    ),
    "fibre_rotation": _fibres,
    "strain_stiffening": lambda given: {"stiffening": given["exponent"] / 4},
    "skin_added": _renamed(skin_added_n_per_m="stiffness_n_per_m"),
    "inclusion": _lump,
    "fibre_contrast": lambda given: {"ln_fibre_contrast": math.log(given["ratio"])},
    "growth": _swelling,
    "local_attachment": _attachment,
    "image_scale": _scale,
    "segmentation_offset": _renamed(
        segmentation_fat_mm="outline_mm", segmentation_glandular_mm="glandular_mm"
    ),
}


def true_values(truth: Truth) -> dict[str, float]:
    """Return parameters of the catalogue under their door names, of all true effects.

    Raises
    ------
    KeyError
        If a cause lacks a parameter.
    """
    out: dict[str, float] = {}
    for cause in truth.causes:
        if cause.effect in IN_CATALOGUE:
            out |= IN_CATALOGUE[cause.effect](cause.parameters)
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
    if found is None or found.name in NOT_PROPORTIONAL:
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
        Middle of the body, from which the found place counts.
    """
    given = next((c.parameters for c in truth.causes if c.effect == INCLUSION.name), None)
    found = by_name.get(INCLUSION.name)
    if given is None or found is None or centre_mm is None or not found.refitted:
        return None
    sizes = {p.parameter: p.magnitude for p in found.parameters}
    doors = {p.name: p.door_name for p in INCLUSION.parameters}
    at = np.add(centre_mm, [sizes[doors[name]] for name in PLACE])
    return float(np.linalg.norm(at - np.asarray(given["centre_mm"])))

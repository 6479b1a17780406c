"""How case.json was read before it was read strictly: by searching its prose.

Kept to show that the cases that were understood then are understood alike now.
"""

import re
from typing import Any

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import FibreField
from palpate.workers.mechanics.fem.problem.loads import Device, ForceControl, Wall


def spring(text: str, name: str) -> float:
    found = re.search(rf"{name}\s*=\s*([\d.eE+-]+)\s*kPa/mm", text)
    return float(found.group(1)) / 1000.0 if found else 0.0


def number(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found is not None
    return float(found.group(1))


def plates(nominal: dict[str, Any]) -> tuple[float, float]:
    lower = number(nominal["plates"], r"lower[^;]*?y\s*=\s*([+-]?[\d.]+)")
    found = re.search(r"upper[^;]*?y\s*=\s*([+-]?[\d.]+)", nominal["plates"])
    return lower, float(found.group(1)) if found else -lower


def problem(
    said: dict[str, Any], load: dict[str, Any], values: dict[str, float], centre
) -> Problem:
    """The nominal problem of a scan that is pressed with a force along an axis."""
    nominal = said["nominal"]
    known = {k: v / 1000.0 for k, v in nominal.get("held_kPa", {}).items()} | values
    lower, upper = load.get("lower_mm"), load.get("upper_mm")
    if lower is None or upper is None:
        lower, upper = plates(nominal)
    axis = tuple(float(v) for v in load.get("compression_axis", (0, 1, 0)))
    walls = nominal["chest_wall"]
    return Problem(
        {
            tissue: Constants(known[name], nominal["nu"], fibre_mpa=known.get("eta", 0.0))
            for tissue, name in ((Tissue.FAT, "E_fat"), (Tissue.GLANDULAR, "E_gl"))
        },
        ForceControl(load["plate_force_N"], lower, upper, Device(axis, centre)),
        fibres=FibreField(axis=tuple(float(v) for v in nominal.get("fibre_direction", (0, 0, 1)))),
        isochoric_fibre="I4bar" in nominal["energy"],
        literal_fibre="tension only" not in nominal["energy"],
        wall=Wall((False, False, True), (spring(walls, "kx"), spring(walls, "ky"), 0.0)),
    )


def noise(said: dict[str, Any]) -> tuple[float, float, bool]:
    """Standard deviation and correlation length in mm, and whether the reference errs."""
    text = said["segmentation"]
    sd = number(text, r"sd\s*([\d.]+)\s*mm")
    return sd, number(text, r"correlation length[^\d]*([\d.]+)\s*mm"), "reference" in text

"""The searches of thesis section 4.5: bodies, targets, bounds.

The thesis assigns target X1 to phantoms 1 to 5 and X2 to phantoms 6 to 10, both without skin, and
X3, with skin, to phantoms 1 to 5 again.
"""

from dataclasses import asdict
from typing import Any, Literal, get_args

from palpate.storage.errors import InputError
from palpate.workers.thesis.phantoms import FULL, NUMBERS, REDUCED, density_of
from palpate.workers.thesis.scale import Scale, check_scale

TargetName = Literal["X1", "X2", "X3"]
TARGETS: dict[TargetName, dict[str, float]] = {
    "X1": {
        "E_fat_kpa": 10.0, "eta_fat_kpa": 100.0,
        "E_glandular_kpa": 40.0, "eta_glandular_kpa": 150.0,
    },
    "X2": {
        "E_fat_kpa": 7.5, "eta_fat_kpa": 75.0,
        "E_glandular_kpa": 30.0, "eta_glandular_kpa": 112.5,
    },
    "X3": {
        "E_fat_kpa": 10.0, "eta_fat_kpa": 100.0,
        "E_glandular_kpa": 40.0, "eta_glandular_kpa": 150.0, "E_skin_kpa": 1600.0,
    },
}  # fmt: skip
BOUNDS: dict[str, tuple[float, float]] = {
    "E_fat_kpa": (5.0, 20.0),
    "eta_fat_kpa": (50.0, 200.0),
    "E_glandular_kpa": (5.0, 80.0),
    "eta_glandular_kpa": (50.0, 200.0),
    "E_skin_kpa": (200.0, 3000.0),
}
PHANTOMS: dict[TargetName, range] = {"X1": range(1, 6), "X2": range(6, 11), "X3": range(1, 6)}
NODES: dict[Scale, int] = {"sketch": 1_200, "reduced": 5_000, "full": 90_000}
SPACING_MM: dict[Scale, float] = {"sketch": 1.0, "reduced": 0.5, "full": 0.2}
# The reduced body is half as long in every direction; this force gives the same pressure.
FORCE_N: dict[Scale, float] = {"sketch": 25.0, "reduced": 25.0, "full": 100.0}


def runs_at(scale: Scale) -> list[tuple[TargetName, int]]:
    """Return the target and phantom of every search at a scale."""
    check_scale(scale)
    return [
        (name, number)
        for name, numbers in PHANTOMS.items()
        for number in numbers
        if number in NUMBERS[scale]
    ]


def case_of(target: TargetName, number: int, scale: Scale) -> dict[str, Any]:
    """Return the case of a study, in the format of `workers.spec`.

    Raises
    ------
    InputError
        If target, number or scale is unknown.
    """
    check_scale(scale)
    if target not in get_args(TargetName):
        raise InputError(f"The target must be one of {', '.join(TARGETS)}; got {target!r}.")
    body = FULL if scale == "full" else REDUCED
    phantom = asdict(body) | {
        "preset": "250ml",
        "seed": number,
        "spacing_mm": SPACING_MM[scale],
        "glandular_fraction": density_of(number),
    }
    return {
        "organ": "breast",
        "reference": {"phantom": phantom},
        "mesh": {"nodes": NODES[scale]},
        "model": {"skin": "membrane" if target == "X3" else "none"},
        "load": {"force_n": FORCE_N[scale]},
        "constants": {"nu": 0.49},
    }


def bounds_of(target: TargetName) -> dict[str, tuple[float, float]]:
    """Return the search bounds of the constants for a target."""
    return {name: BOUNDS[name] for name in TARGETS[target]}

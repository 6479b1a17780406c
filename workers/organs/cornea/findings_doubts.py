"""Findings of a fitted eye that bear on which of its values may be quoted."""

from collections.abc import Mapping
from typing import Any

from workers.organs.cornea.findings_notes import NOT_MEASURED, UNKNOWN_FROM


def derived(numbers: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the values that follow from the constants: G0, the shear modulus at rest.

    Returns
    -------
    list of dict
        ``name``, ``value`` in ``unit``, ``relative_sd`` of a simulated and of an imaged target,
        and ``against``: clauses that say why it may not be quoted.
    """
    bounds = numbers["shear_modulus_bounds"]
    return [
        {
            "name": "G0",
            "value": 1000 * numbers["shear_modulus_mpa"],
            "unit": "kPa",
            "relative_sd": {"simulated": bounds["pixels"], "image": bounds["model"]},
            "against": _assumed(numbers),
        }
    ]


def against(numbers: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return for each constant the clauses that say why it may not be quoted."""
    bounds, noise = numbers["bounds"]["model"], numbers["noises"]["model"]
    found = {}
    for name, bound in bounds.items():
        loose = bound > UNKNOWN_FROM
        clause = f"errors of model and image of {noise} leave it uncertain by more than half"
        found[name.removesuffix("_mpa")] = [*_assumed(numbers), *([clause] if loose else [])]
    return found


def _assumed(numbers: Mapping[str, Any]) -> list[str]:
    missing = [NOT_MEASURED[one] for one in numbers["not_measured"]]
    verb = "is" if len(missing) == 1 else "are"
    return [f"{' and '.join(missing)} {verb} assumed, not measured"] if missing else []

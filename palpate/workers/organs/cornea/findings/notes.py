"""Findings about a fitted eye as sentences."""

from collections.abc import Mapping
from typing import Any

from palpate.workers.organs.cornea.spec import CorneaCase

NOT_MEASURED = {
    "iop": "the pressure of the eye",
    "pachymetry": "the thickness of the cornea",
    "jet_pressure": "the pressure of the jet",
}
# Above this bound a constant is no better known than its searched interval.
UNKNOWN_FROM = 0.5


def notes(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Return sentences on identifiable values, limitations, and the order of the terms."""
    return [
        *_missing(numbers, case),
        _shear_modulus(numbers),
        _constants(numbers),
        *_several(numbers),
        _order(case),
    ]


def _missing(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Return a sentence on the usable results if something was assumed without measurement."""
    missing = numbers["not_measured"]
    if not missing:
        return []
    *others, last = [NOT_MEASURED[one] for one in missing]
    what = f"{', '.join(others)} and {last}" if others else last
    verb = "was" if len(missing) == 1 else "were"
    sentence = (
        f"{what[0].upper()}{what[1:]} {verb} not measured with these images but {verb} assumed "
        f"(IOP {case.load.iop_mmhg:g} mmHg, jet {1000 * case.load.jet.pressure_mpa:g} kPa). "
        "Contours, displacements, the similarity, and comparisons of this eye with itself may be "
        "used. Mu, alpha, G0 and the stress-stretch curve may not be used as properties "
        "of the tissue; they hold under these assumptions only."
    )
    changed = [numbers["assumptions"][one] for one in missing if one in numbers["assumptions"]]
    if not changed:
        return [sentence]
    parts = ", ".join(
        f"{one['by']} changes G0 by {100 * one['shear_modulus_part']:+.1f} % and the stress at the "
        f"best known stretch by {100 * one['stress_part']:+.1f} %"
        for one in changed
    )
    return [sentence, f"Influence of these assumptions, with refitted constants: {parts}."]


def _shear_modulus(numbers: Mapping[str, Any]) -> str:
    bounds, names = numbers["shear_modulus_bounds"], numbers["noises"]
    return (
        "An image determines G0 = 1/2 Σ μα and the stress at the stretches that the eye attains, "
        f"up to {numbers['attained_stretches'][1]:.3f}; their 90 % intervals are listed with the "
        f"estimates. With an error of model or segmentation of {names['model']}, one such image "
        f"{_fixes(bounds['model'])} (one standard deviation, Cramer-Rao)."
    )


def _fixes(bound: float) -> str:
    return f"determines G0 to {_percent(bound)}" if bound < 1 else "does not determine G0"


def _percent(part: float) -> str:
    """Return a fraction as a percentage with two digits or more."""
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


def _constants(numbers: Mapping[str, Any]) -> str:
    values = numbers["singular_values_um"]
    bounds = numbers["bounds"]["model"]
    loose = [name for name, bound in bounds.items() if bound > UNKNOWN_FROM]
    strong = sum(value > 1.0 for value in values)
    text = f"{strong} of {len(values)} combinations of the constants move the contour by more "
    text += "than 1 µm when they grow by a factor of e. "
    if len(loose) == len(bounds):
        return text + "No single constant is known to better than half its value."
    known = ", ".join(_plain(name) for name in bounds if name not in loose)
    return text + f"Only these constants are known to better than half their value: {known}."


def _several(numbers: Mapping[str, Any]) -> list[str]:
    several, repeated = (
        numbers["bounds_of_several_pressures"],
        numbers["bounds_of_one_pressure_repeated"],
    )
    if several is None:
        return []
    gains = ", ".join(f"{_plain(name)} {repeated[name] / several[name]:.1f}" for name in several)
    count = len(numbers["jet_fractions"])
    return [
        f"{count} frames of one puff, at {count} pressures of the jet, would determine the "
        f"constants better than as many images at the present pressure, by these factors: {gains}."
    ]


def _order(case: CorneaCase) -> str:
    by = case.model.order_terms_by
    if by == "nothing":
        return (
            "Swapping the two terms of the law does not change the cornea, and they are listed "
            "as they were found: compare G0 and the curve, not the constants."
        )
    return (
        "Swapping the two terms of the law does not change the cornea. They are sorted by "
        f"{by} in ascending order, so that constants of several eyes can be compared."
    )


def _plain(name: str) -> str:
    return name.removesuffix("_mpa")

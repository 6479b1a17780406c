"""The findings of a fitted eye as sentences for a reader."""

from collections.abc import Mapping
from typing import Any

from palpate.workers.organs.cornea.spec import CorneaCase

NOT_MEASURED = {
    "iop": "the pressure of the eye",
    "pachymetry": "the thickness of the cornea",
    "jet_pressure": "the pressure of the jet",
}
# Beyond this bound a constant is no better known than its interval.
UNKNOWN_FROM = 0.5


def notes(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Return sentences: what is known, what is not, and what the order of terms means."""
    return [
        *_missing(numbers, case),
        _shear_modulus(numbers),
        _constants(numbers),
        *_several(numbers),
        _order(case),
    ]


def _missing(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Say which numbers may be used where something was assumed that nobody has measured."""
    missing = numbers["not_measured"]
    if not missing:
        return []
    *others, last = [NOT_MEASURED[one] for one in missing]
    what = f"{', '.join(others)} and {last}" if others else last
    verb = "was" if len(missing) == 1 else "were"
    sentence = (
        f"{what[0].upper()}{what[1:]} {verb} not measured with these images but {verb} assumed "
        f"(IOP {case.load.iop_mmhg:g} mmHg, jet {1000 * case.load.jet.pressure_mpa:g} kPa). "
        "May be used: contours, displacements, the similarity, and how this eye compares with "
        "itself. May not be used as properties of the tissue: mu, alpha, G0 and the curve of "
        "stress over stretch; they hold under these assumptions only."
    )
    changed = [numbers["assumptions"][one] for one in missing if one in numbers["assumptions"]]
    if not changed:
        return [sentence]
    parts = ", ".join(
        f"{one['by']} changes G0 by {100 * one['shear_modulus_part']:+.1f} % and the stress at the "
        f"best known stretch by {100 * one['stress_part']:+.1f} %"
        for one in changed
    )
    return [sentence, f"How much hangs on that, the constants fitted again: {parts}."]


def _shear_modulus(numbers: Mapping[str, Any]) -> str:
    bounds, names = numbers["shear_modulus_bounds"], numbers["noises"]
    return (
        "An image determines G0 = 1/2 Σ μα and the stress at the stretches that the eye attains, "
        f"up to {numbers['attained_stretches'][1]:.3f}; their 90 % intervals are with the "
        f"estimates. With an error of model or segmentation of {names['model']}, one such image "
        f"{_fixes(bounds['model'])} (one standard deviation, Cramer-Rao)."
    )


def _fixes(bound: float) -> str:
    return f"fixes G0 to {_percent(bound)}" if bound < 1 else "does not fix G0"


def _percent(part: float) -> str:
    """Return a part in per cent with two digits, or all of them before the point."""
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


def _constants(numbers: Mapping[str, Any]) -> str:
    values = numbers["singular_values_um"]
    bounds = numbers["bounds"]["model"]
    loose = [name for name, bound in bounds.items() if bound > UNKNOWN_FROM]
    strong = sum(value > 1.0 for value in values)
    text = f"{strong} of {len(values)} combinations of the constants move the contour by more "
    text += "than 1 µm when they grow by a factor of e. "
    if len(loose) == len(bounds):
        return text + "No constant on its own is known better than to half its value."
    known = ", ".join(_plain(name) for name in bounds if name not in loose)
    return text + f"On their own, only these are known better than to half their value: {known}."


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
        f"{count} frames of one puff, at {count} pressures of the jet, would fix the constants "
        f"better than as many images of the present one, by these factors: {gains}."
    ]


def _order(case: CorneaCase) -> str:
    by = case.model.order_terms_by
    if by == "nothing":
        return (
            "The two terms of the law may change places without any change of the cornea, and "
            "stand here as they were found: compare G0 and the curve, not the constants."
        )
    return (
        "The two terms of the law may change places without any change of the cornea. They are "
        f"put in order by {by}, least first, so that constants of several eyes can be compared."
    )


def _plain(name: str) -> str:
    return name.removesuffix("_mpa")

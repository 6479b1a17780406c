"""The findings of a fitted eye as figures of a report."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's colours, as in the report.
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")
SOFT = "#5d6775"
SMALL_PT = 9.0
# Smaller parts of a combination are not named.
LEAST_PART = 0.15

Described = tuple[Figure, str]


def figures(
    numbers: Mapping[str, Any], derived: Sequence[Mapping[str, Any]] = ()
) -> Iterator[Described]:
    """Yield figures of the findings, each with its caption.

    ``derived`` are values with their ``interval``, if it is known.
    """
    yield _curve(numbers, derived)
    yield _singular_values(numbers)
    yield _bounds(numbers)
    if "profiles" in numbers:
        yield _profiles(numbers["profiles"])


def image_figure(image: np.ndarray[Any, Any]) -> Figure:
    """Return a colour image as a figure of the page's width."""
    shown = Figure(figsize=(10.4, 10.4 * image.shape[0] / image.shape[1]), layout="constrained")
    axes = shown.subplots()
    axes.imshow(image)
    axes.axis("off")
    return shown


def _axes(x_label: str, y_label: str, height_in: float = 3.4) -> tuple[Figure, Axes]:
    shown = Figure(figsize=(7.8, height_in), layout="constrained", facecolor="white")
    axes = shown.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=SOFT, labelsize=SMALL_PT)
    axes.grid(True, axis="y", color="#d8dde4", linewidth=0.7)
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.set_axisbelow(True)
    return shown, axes


def _curve(numbers: Mapping[str, Any], derived: Sequence[Mapping[str, Any]]) -> Described:
    curve = numbers["stress_curve"]
    shown, axes = _axes("stretch", "stress, MPa")
    axes.plot(curve["stretch"], curve["stress_mpa"], color=COLOURS[0], linewidth=1.8)
    known = [one for one in derived if "stretch" in one and one.get("interval") is not None]
    for one in known:
        low, high = (end / 1000 for end in one["interval"])
        axes.errorbar(
            one["stretch"],
            one["value"] / 1000,
            [[one["value"] / 1000 - low], [high - one["value"] / 1000]],
            color=COLOURS[0],
            capsize=4,
        )
    axes.axvline(curve["attained"], color=SOFT, linestyle=":", linewidth=1.2)
    bars = " with 90 % intervals" if known else ""
    return shown, (
        f"Stress against stretch for the fitted law, for a strip under tension{bars}. Dotted: the "
        "largest stretch in this eye; the image does not determine the curve beyond it."
    )


def _singular_values(numbers: Mapping[str, Any]) -> Described:
    labels = [
        "\n".join(
            f"{_plain(name)} {part:+.2f}"
            for name, part in zip(numbers["constants"], direction, strict=True)
            if abs(part) > LEAST_PART
        )
        for direction in numbers["directions"]
    ]
    shown, axes = _axes("", "shift, µm", 4.0)
    _marks(axes, {"": numbers["singular_values_um"]}, labels)
    return shown, (
        "Shift of the contour, root mean square, when a combination of the logarithms of the "
        "constants grows by one. Combinations whose shift is below the resolution of the image "
        "may take any value."
    )


def _bounds(numbers: Mapping[str, Any]) -> Described:
    noises, bounds = numbers["noises"], numbers["bounds"]
    count = len(numbers["jet_fractions"])
    series = {f"one image, {noises[key]}": bounds[key] for key in ("model", "pixels")}
    if numbers["bounds_of_several_pressures"] is not None:
        several = f"{count} pressures of the jet, {noises['pixels']}"
        series[several] = numbers["bounds_of_several_pressures"]
    shown, axes = _axes("", "relative error, %")
    percents = {title: [100 * v for v in one.values()] for title, one in series.items()}
    _marks(axes, percents, [_plain(name) for name in numbers["constants"]])
    axes.legend(frameon=False, fontsize=SMALL_PT, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return shown, ("Uncertainty of each constant: Cramer-Rao bounds, one standard deviation.")


def _profiles(profiles: Sequence[Mapping[str, Any]]) -> Described:
    shown, axes = _axes("held value over fitted value", "misfit, µm")
    for profile, colour in zip(profiles, COLOURS, strict=False):
        y = [np.nan if value is None else value for value in profile["misfit_um"]]
        axes.plot(profile["factor"], y, "o-", color=colour, label=_plain(profile["name"]))
    axes.legend(frameon=False, fontsize=SMALL_PT)
    return shown, (
        "Smallest misfit of the contour with one constant held at a multiple of its fitted value "
        "and the others refitted. Values with a misfit below the image error are compatible with "
        "the image."
    )


def _marks(axes: Axes, series: Mapping[str, Sequence[float]], names: Sequence[str]) -> None:
    for (title, values), colour in zip(series.items(), COLOURS, strict=False):
        axes.plot(range(len(values)), values, "o", color=colour, label=title)
    axes.set_yscale("log")
    axes.set_xticks(range(len(names)), names, fontsize=SMALL_PT)
    axes.set_xlim(-0.5, len(names) - 0.5)


def _plain(name: str) -> str:
    return name.removesuffix("_mpa")

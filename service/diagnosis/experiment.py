"""What a diagnosis says of a bench experiment, in lines for a console."""

from collections.abc import Iterator, Mapping
from typing import Any

from service.diagnosis.words import measured, spoken

Json = Mapping[str, Any]
# A relative change of a constant that is not worth a line.
SMALL = 0.02


def experiment_lines(summary: Json) -> Iterator[str]:
    """Constants, what hides in them, and states to come; nothing for scans."""
    if "predictions" not in summary:
        return
    for name, found in summary["constants"].items():
        after = found["after"]
        was = f"{found['before']:.0f} kPa"
        found_too = "" if after is None else f", with what was found {after:.0f} kPa"
        yield f"{_constant(name)}: {was}{found_too}"
    for one in summary["hidden"]:
        for name, kpa in one["constants_kpa"].items():
            if abs(kpa["with"] / kpa["without"] - 1) < SMALL:
                continue
            yield (
                f"With {spoken(one['name'])} ({_size(one['size'])}) {name} would be "
                f"{kpa['with']:.0f} kPa instead of {kpa['without']:.0f} kPa: these states cannot "
                "tell the two apart."
            )
    for state in summary["predictions"]:
        yield f"Expected at {state['state']}, along x, y and z of the body:"
        for point in state["points"]:
            parts = zip(point["displacement_mm"], point["sd_mm"], strict=True)
            moved = ", ".join(measured(value, max(sd, 0.01), "mm") for value, sd in parts)
            yield f"  {point['name']}: {moved}"


def _constant(name: str) -> str:
    return name.removesuffix("_kpa")


def _size(values: Json) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in values.items())

"""Results of a diagnosis of a bench experiment, as lines for a console."""

import math
from collections.abc import Iterator, Mapping

from palpate.service.diagnosis.words import difference, least_length, measured, spoken
from palpate.service.formatting import NONE, number
from palpate.workers.diagnosis.schema.summary import Summary

# Smaller relative changes in a constant are not reported.
SMALL = 0.02
# Number of points printed for a state; the page has all.
SHOWN = 12


def experiment_lines(summary: Summary) -> Iterator[str]:
    """Yield forces, absorbed effects and predicted states; nothing for scans."""
    if summary.predictions is None:
        return
    yield from summary.data_notes
    yield from _force_lines(summary)
    for effect in summary.hidden or ():
        for name, kpa in effect.constants_kpa.items():
            if abs(kpa["with"] / kpa["without"] - 1) < SMALL:
                continue
            yield (
                f"With {spoken(effect.name)} ({_size(effect.size)}) {name} would be "
                f"{number(kpa['with'], 3)} kPa instead of {number(kpa['without'], 3)} kPa: these "
                "states cannot distinguish the two."
            )
    least_mm = least_length(summary.gap_mm)
    for state in summary.predictions:
        yield f"Expected at {state.state}, along x, y and z of the body:"
        for point in state.points[:SHOWN]:
            parts = zip(point.displacement_mm, point.sd_mm, strict=True)
            moved = ", ".join(
                NONE if math.isnan(value) else measured(value, max(sd, least_mm), "mm")
                for value, sd in parts
            )
            yield f"  {point.name}: {moved}"
        if len(state.points) > SHOWN:
            yield f"  and {len(state.points) - SHOWN} further points: see the page, or --json"
        for one in state.reactions:
            force = measured(one.force_n, one.sd_n, "N")
            yield f"  force on {one.place}: {force}"


def _force_lines(summary: Summary) -> Iterator[str]:
    """Yield a line for each measured force."""
    for state in summary.markers or ():
        for one in state.reactions:
            left = one.before_n if one.after_n is None else one.after_n
            read = measured(one.force_n, one.sd_n, "N")
            yield (
                f"Force on {one.place} at {state.state}: {read}; the model is "
                f"off by {difference(left, one.sd_n)} N"
            )


def _size(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in values.items())

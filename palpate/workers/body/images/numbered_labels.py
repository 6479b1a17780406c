"""What is known of labels that have numbers and no names: their volumes and where they lie.

A number means no tissue by itself: 1 is fat in one program and glandular tissue in another.
"""

from collections.abc import Iterator, Mapping
from typing import NoReturn

import numpy as np
from scipy.ndimage import binary_erosion

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, Volume
from palpate.workers.body.images.image_formats import LabelImage
from palpate.workers.body.images.tissue_labels import label_counts

# Number of labels that are described; an image of grey values has hundreds.
DESCRIBED = 8
AXES = "zyx"


def refuse_numbers(image: LabelImage) -> NoReturn:
    """Raise InputError with the labels of an image without names, and the line to complete."""
    counts = label_counts(image.volume)
    shown = list(counts)[:DESCRIBED]
    more = f" and {len(counts) - DESCRIBED} more labels" if len(counts) > DESCRIBED else ""
    known = [(label, "?" if label else "air") for label in shown]
    written = ", ".join(f"{label}: {tissue}" for label, tissue in known)
    option = ",".join(f"{label}={tissue}" for label, tissue in known)
    rest = ", ..." if more else ""
    raise InputError(
        f"{image.where} has numbers as labels and no names, and a number may mean any tissue. "
        f"Found {'; '.join(_described(image.volume, {k: counts[k] for k in shown}))}{more}. "
        f"Name the tissue of each, with fat, glandular, skin, muscle, ligament or air for each ?. "
        f"In a file:\n  labels: {{{written}{rest}}}\n"
        f"For `palpate import`:\n  --labels '{option}{rest.replace(' ', '')}'"
    )


def _described(volume: Volume, counts: Mapping[int, int]) -> Iterator[str]:
    """Yield number, volume, share of the outline of the body and box of each label."""
    body = np.asarray(volume.values != 0)
    outline = body & ~binary_erosion(body, border_value=1)
    whole = max(int(np.count_nonzero(outline)), 1)
    for label, count in counts.items():
        ml = f"{label}: {count * volume.voxel_mm3 / 1000:.3g} ml"
        there = np.asarray(volume.values == label)
        if label == 0:
            yield f"{ml}, taken as the air around the body"
            continue
        share = int(np.count_nonzero(there & outline)) / whole
        yield f"{ml}, {share:.0%} of the body's surface, {_box(volume, there)}"


def _box(volume: Volume, there: BoolArray) -> str:
    """Return the first and the last voxel centre along x, y and z in words."""
    ends = []
    for number, axis in enumerate(AXES):
        line = np.flatnonzero(there.any(axis=tuple(k for k in range(3) if k != number)))
        origin, spacing = volume.origin_mm[2 - number], volume.spacing_mm[2 - number]
        low, high = (round(float(origin + spacing * end), 1) + 0.0 for end in (line[0], line[-1]))
        ends.append(f"{axis} {low:.4g} to {high:.4g}")
    return ", ".join(reversed(ends)) + " mm"

"""What was seen and what is expected of each point, as plain numbers for a summary."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from workers.diagnosis.diagnosis import Diagnosis
from workers.specimen.observed import Observed
from workers.specimen.predict import Prediction

Json = dict[str, Any]


def marker_rows(seen: Observed, states: Sequence[str], found: Diagnosis) -> list[Json]:
    """Each state, and each of its points: what was seen, and what the models leave of it.

    ``displacement_mm``, ``before_mm`` and ``after_mm`` are along x, y and z of the body; the
    last is None where no effect is accused. ``repeats_mm`` is the mean absolute difference
    of two repeats, None for one.
    """
    shape = seen.moved_mm.shape
    before = found.look.linear.residual.reshape(shape)
    after = None
    if found.best is not None:
        after = found.best.fit.linearised(found.look.subject).residual.reshape(shape)
    return [
        {
            "state": state,
            "repeats_mm": None if np.isnan(seen.repeats_mm[s]) else seen.repeats_mm[s],
            "points": [
                {
                    "name": name,
                    "displacement_mm": seen.moved_mm[s, i].tolist(),
                    "before_mm": before[s, i].tolist(),
                    "after_mm": None if after is None else after[s, i].tolist(),
                }
                for i, name in enumerate(seen.names)
            ],
        }
        for s, state in enumerate(states)
    ]


def prediction_rows(seen: Observed, found: Sequence[Prediction]) -> list[Json]:
    """Each state that was not measured: displacements of its points and their deviations.

    ``displacement_mm`` and ``sd_mm`` are along x, y and z of the body.
    """
    return [
        {
            "state": one.name,
            "points": [
                {"name": name, "displacement_mm": moved.tolist(), "sd_mm": sd.tolist()}
                for name, moved, sd in zip(seen.names, one.moved_mm, one.sd_mm, strict=True)
            ],
        }
        for one in found
    ]

"""What was observed and what is expected of each point of a specimen, as rows of a summary."""

from collections.abc import Sequence

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.summary import (
    MarkerResidual,
    MarkerState,
    PredictedPoint,
    PredictedState,
    Triple,
)
from workers.organs.specimen.marker_data import Observed
from workers.organs.specimen.prediction import Prediction


def marker_states(
    observed: Observed, states: Sequence[str], diagnosis: Diagnosis
) -> tuple[MarkerState, ...]:
    """Return what the points of each state have done, and what the models leave of it.

    Parameters
    ----------
    observed : Observed
    states : sequence of str
        Names.
    diagnosis : Diagnosis
    """
    shape = observed.moved_mm.shape
    before = diagnosis.analysis.linear.residual.reshape(shape)
    after = None
    if diagnosis.best is not None:
        fitted = diagnosis.best.fit.linearised(diagnosis.analysis.inverse)
        after = fitted.residual.reshape(shape)
    return tuple(
        MarkerState(
            state,
            None if np.isnan(observed.repeats_mm[s]) else observed.repeats_mm[s],
            tuple(
                MarkerResidual(
                    name,
                    _triple(observed.moved_mm[s, i]),
                    _triple(before[s, i]),
                    None if after is None else _triple(after[s, i]),
                )
                for i, name in enumerate(observed.names)
            ),
        )
        for s, state in enumerate(states)
    )


def predicted_states(
    observed: Observed, predictions: Sequence[Prediction]
) -> tuple[PredictedState, ...]:
    """Return where the points of each state that was not measured are expected."""
    return tuple(
        PredictedState(
            one.name,
            tuple(
                PredictedPoint(name, _triple(moved), _triple(sd))
                for name, moved, sd in zip(observed.names, one.moved_mm, one.sd_mm, strict=True)
            ),
        )
        for one in predictions
    )


def _triple(values: FloatArray) -> Triple:
    x, y, z = values.tolist()
    return x, y, z

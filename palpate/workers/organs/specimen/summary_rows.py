"""Rows of a summary: observed and predicted displacements of each point of a specimen."""

from collections.abc import Iterator, Sequence

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.algebra.linear_fit import LinearFit
from palpate.workers.diagnosis.outcome.region_gap import region_gap
from palpate.workers.diagnosis.schema.experiment_summary import (
    MarkerResidual,
    MarkerState,
    PredictedPoint,
    PredictedState,
    Reaction,
    ReactionResidual,
)
from palpate.workers.diagnosis.schema.summary import RegionGap
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis
from palpate.workers.organs.specimen.keys.loads import PredictSpec
from palpate.workers.organs.specimen.load_cells import LoadCell
from palpate.workers.organs.specimen.prediction import Prediction
from palpate.workers.organs.specimen.readings.marker_data import Observed
from palpate.workers.organs.specimen.spec import SpecimenSpec

COMPONENTS = ("displacement along x", "displacement along y", "displacement along z")


def region_rows(diagnosis: Diagnosis) -> Iterator[RegionGap]:
    """Yield the gap of the nominal model along each axis, for all points and by thirds.

    The thirds divide the points along the axis of their largest extent.
    """
    inverse, fit = diagnosis.analysis.inverse, LinearFit(diagnosis.analysis.linear)
    points, component = inverse.points.points, inverse.points.interface
    own = ~inverse.is_force
    longest = int(np.ptp(points[own], axis=0).argmax())
    low, high = points[own, longest].min(), points[own, longest].max()
    along = 3 * (points[:, longest] - low) / max(high - low, 1e-12)
    name = "xyz"[longest]
    parts = {
        "all": np.ones(len(along), np.bool_),
        f"lowest third of {name}": along < 1,
        f"middle third of {name}": (along >= 1) & (along <= 2),
        f"highest third of {name}": along > 2,
    }
    for number, scan in enumerate(inverse.scans):
        for axis, seen in enumerate(COMPONENTS):
            for region, inside in parts.items():
                chosen = np.tile(own & inside & (component == axis), len(inverse.scans))
                chosen &= inverse.rows == number
                if chosen.sum() >= SETTINGS.gap.fewest_residuals:
                    yield region_gap(fit, chosen, scan.name, seen, region)


def marker_states(
    observed: Observed, spec: SpecimenSpec, cells: Sequence[LoadCell], diagnosis: Diagnosis
) -> tuple[MarkerState, ...]:
    """Return the observed displacements of each state and the residuals of the models.

    Parameters
    ----------
    observed : Observed
    spec : SpecimenSpec
    cells : sequence of LoadCell
    diagnosis : Diagnosis
    """
    inverse = diagnosis.analysis.inverse
    whole, place = diagnosis.analysis.linear.residual, inverse.is_place
    before, forces = _at_points(observed, whole[place]), whole[~place]
    after, forces_after = None, None
    if diagnosis.best is not None:
        whole = diagnosis.best.fit.linearised(inverse).residual
        after, forces_after = _at_points(observed, whole[place]), whole[~place]
    reactions = _reactions(spec, cells, forces, forces_after)
    return tuple(
        MarkerState(
            state.name,
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
            reactions[s],
        )
        for s, state in enumerate(spec.states)
    )


def _at_points(observed: Observed, compared: FloatArray) -> FloatArray:
    """Return the compared components of all states as points, shape (s, k, 3)."""
    states = compared.reshape(len(observed.moved_mm), -1)
    return np.array([_spread(observed, state) for state in states])


def _spread(observed: Observed, compared: FloatArray) -> FloatArray:
    """Return the compared components of one state, nan elsewhere, shape (k, 3)."""
    found = np.full(observed.measured.shape, np.nan)
    found[observed.measured] = compared
    return found


def predicted_states(
    observed: Observed,
    spec: SpecimenSpec,
    cells: Sequence[LoadCell],
    predictions: Sequence[Prediction],
) -> tuple[PredictedState, ...]:
    """Return the predicted displacements and forces of each state that was not measured."""
    return tuple(
        PredictedState(
            one.name,
            tuple(
                PredictedPoint(name, _triple(moved), _triple(sd))
                for name, moved, sd in zip(
                    observed.names,
                    _spread(observed, one.moved_mm),
                    _spread(observed, one.sd_mm),
                    strict=True,
                )
            ),
            tuple(_predicted_reactions(spec, state, cells, one)),
        )
        for one, state in zip(predictions, spec.predict, strict=True)
    )


def _reactions(
    spec: SpecimenSpec,
    cells: Sequence[LoadCell],
    before_mm: FloatArray,
    after_mm: FloatArray | None,
) -> list[tuple[ReactionResidual, ...]]:
    """Return the readings and residuals of each state, from residuals in mm of all states."""
    shape = len(spec.states), len(cells)
    before = before_mm.reshape(shape)
    after = None if after_mm is None else after_mm.reshape(shape)
    return [
        tuple(
            ReactionResidual(
                one.region,
                one.axis,
                one.force_n,
                one.sd_n,
                float(before[s, c] / cell.mm_per_n),
                None if after is None else float(after[s, c] / cell.mm_per_n),
            )
            for c, (one, cell) in enumerate(zip(state.reactions, cells, strict=True))
        )
        for s, state in enumerate(spec.states)
    ]


def _predicted_reactions(
    spec: SpecimenSpec, state: PredictSpec, cells: Sequence[LoadCell], predicted: Prediction
) -> Iterator[Reaction]:
    """Yield the predicted forces on the regions that move in a state."""
    moved = {(move.region, axis) for move in state.moves for axis in move.axes}
    read = zip(
        spec.states[0].reactions, cells, predicted.force_mm, predicted.force_sd_mm, strict=True
    )
    for one, cell, force_mm, sd_mm in read:
        if (one.region, one.axis) in moved:
            values = float(force_mm / cell.mm_per_n), float(sd_mm / cell.mm_per_n)
            yield Reaction(one.region, one.axis, *values)


def _triple(values: FloatArray) -> Triple:
    x, y, z = values.tolist()
    return x, y, z

"""Tables for a bench experiment: markers, forces, absorbed effects and predictions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.diagnosis.words import (
    decimals,
    difference,
    least_length,
    length,
    measured,
    signed,
    spoken,
)
from palpate.service.formatting import NONE, number
from palpate.storage.values import Triple
from palpate.workers.diagnosis.schema.experiment_summary import PredictedPoint
from palpate.workers.diagnosis.schema.summary import Summary


@dataclass(frozen=True)
class MarkerRow:
    """One marker in one state; triples are along x, y and z of the body."""

    state: str
    name: str
    moved: str
    before: str
    after: str


@dataclass(frozen=True)
class ForceRow:
    """One reading of a load cell, and the residuals of the models, in N."""

    state: str
    place: str
    force: str
    before: str
    after: str


@dataclass(frozen=True)
class StateRow:
    """Misfit of all markers of a state, and the difference between repeats."""

    state: str
    before: str
    after: str
    repeats: str


@dataclass(frozen=True)
class HiddenRow:
    """The value of a constant with and without an effect that it absorbs."""

    effect: str
    size: str
    constant: str
    without: str
    along: str


@dataclass(frozen=True)
class ExpectedRow:
    """The predicted position of a marker in a state that was not measured."""

    state: str
    name: str
    moved: tuple[str, str, str]


@dataclass(frozen=True)
class ExpectedForceRow:
    """The predicted force in N on a region in a state that was not measured."""

    state: str
    place: str
    force: str


def markers(summary: Summary) -> list[MarkerRow]:
    """Return a row for each marker of each state."""
    digits = decimals(summary.gap_mm.noise_floor)
    return [
        MarkerRow(
            state.state,
            point.name,
            _triple(point.displacement_mm, digits),
            _triple(point.before_mm, digits),
            _triple(point.after_mm, digits),
        )
        for state in summary.markers or ()
        for point in state.points
    ]


def forces(summary: Summary) -> list[ForceRow]:
    """Return a row for each reading of each state."""
    return [
        ForceRow(
            state.state,
            one.place,
            measured(one.force_n, one.sd_n, ""),
            difference(one.before_n, one.sd_n),
            NONE if one.after_n is None else difference(one.after_n, one.sd_n),
        )
        for state in summary.markers or ()
        for one in state.reactions
    ]


def states(summary: Summary) -> list[StateRow]:
    """Return a row for each state."""
    return [
        StateRow(
            state.state,
            _rms([point.before_mm for point in state.points]),
            _rms([point.after_mm for point in state.points]),
            NONE if state.repeats_mm is None else length(state.repeats_mm),
        )
        for state in summary.markers or ()
    ]


def hidden(summary: Summary) -> list[HiddenRow]:
    """Return a row for each constant that an undetectable effect would change."""
    return [
        HiddenRow(
            spoken(one.name),
            ", ".join(f"{name.replace('_', ' ')} {number(v, 2)}" for name, v in one.size.items()),
            name,
            number(kpa["without"], 3),
            number(kpa["with"], 3),
        )
        for one in summary.hidden or ()
        for name, kpa in one.constants_kpa.items()
    ]


def expected(summary: Summary) -> list[ExpectedRow]:
    """Return a row for each marker of each predicted state."""
    least_mm = least_length(summary.gap_mm)
    return [
        ExpectedRow(state.state, point.name, _deviating(point, least_mm))
        for state in summary.predictions or ()
        for point in state.points
    ]


def expected_forces(summary: Summary) -> list[ExpectedForceRow]:
    """Return a row for each force of each predicted state."""
    return [
        ExpectedForceRow(state.state, one.place, measured(one.force_n, one.sd_n, ""))
        for state in summary.predictions or ()
        for one in state.reactions
    ]


def _triple(values: Triple | None, digits: int) -> str:
    if values is None:
        return NONE
    return ", ".join(NONE if math.isnan(v) else signed(v, digits) for v in values)


def _deviating(point: PredictedPoint, least_mm: float) -> tuple[str, str, str]:
    x, y, z = (
        NONE if math.isnan(value) else measured(value, max(sd, least_mm), "")
        for value, sd in zip(point.displacement_mm, point.sd_mm, strict=True)
    )
    return x, y, z


def _rms(residuals: Sequence[Triple | None]) -> str:
    known = [triple for triple in residuals if triple is not None]
    if len(known) < len(residuals):
        return NONE
    return length(float(np.sqrt(np.nanmean(np.square(known)))))

"""What the page says of a bench experiment: its markers, what hides, states to come."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.diagnosis.words import measured, signed, spoken
from service.report.words import NONE, number

Json = Mapping[str, Any]
# Axes by how far a point has moved are told to a hundredth of a millimetre.
DIGITS = 2
# A standard deviation below this is printed as this.
LEAST_MM = 0.01


@dataclass(frozen=True)
class MarkerRow:
    """One marker in one state; triples are along x, y and z of the body."""

    state: str
    name: str
    moved: str
    before: str
    after: str


@dataclass(frozen=True)
class StateRow:
    """Misfit of all markers of a state, and how far two repeats differ."""

    state: str
    before: str
    after: str
    repeats: str


@dataclass(frozen=True)
class HiddenRow:
    """What a constant would be with an effect that it hides."""

    effect: str
    size: str
    constant: str
    without: str
    along: str


@dataclass(frozen=True)
class ExpectedRow:
    """Where a marker is expected in a state that was not measured."""

    state: str
    name: str
    moved: tuple[str, str, str]


def markers(told: Json) -> list[MarkerRow]:
    """A row for each marker of each state."""
    return [
        MarkerRow(
            state["state"], point["name"], _triple(point["displacement_mm"]),
            _triple(point["before_mm"]), _triple(point["after_mm"]),
        )
        for state in told.get("markers", ())
        for point in state["points"]
    ]  # fmt: skip


def states(told: Json) -> list[StateRow]:
    """A row for each state."""
    return [
        StateRow(
            state["state"],
            _rms(state["points"], "before_mm"),
            _rms(state["points"], "after_mm"),
            NONE if state["repeats_mm"] is None else f"{state['repeats_mm']:.2f}",
        )
        for state in told.get("markers", ())
    ]


def hidden(told: Json) -> list[HiddenRow]:
    """A row for each constant that an effect which cannot be seen would change."""
    return [
        HiddenRow(
            spoken(one["name"]),
            ", ".join(
                f"{name.replace('_', ' ')} {number(v, 2)}" for name, v in one["size"].items()
            ),
            name,
            f"{kpa['without']:.0f}",
            f"{kpa['with']:.0f}",
        )
        for one in told.get("hidden", ())
        for name, kpa in one["constants_kpa"].items()
    ]


def expected(told: Json) -> list[ExpectedRow]:
    """A row for each marker of each state to come."""
    return [
        ExpectedRow(state["state"], point["name"], _deviating(point))
        for state in told.get("predictions", ())
        for point in state["points"]
    ]


def _triple(values: list[float] | None) -> str:
    return NONE if values is None else ", ".join(signed(v, DIGITS) for v in values)


def _deviating(point: Json) -> tuple[str, str, str]:
    x, y, z = (
        measured(value, max(sd, LEAST_MM), "")
        for value, sd in zip(point["displacement_mm"], point["sd_mm"], strict=True)
    )
    return x, y, z


def _rms(points: list[Json], key: str) -> str:
    if any(point[key] is None for point in points):
        return NONE
    return f"{np.sqrt(np.mean([np.square(point[key]) for point in points])):.2f}"

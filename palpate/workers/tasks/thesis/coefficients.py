"""The bar and the cylinder of thesis section 3.3, as tasks.

::

    bend_bar        one of nine loads   > the displacement
    compare_bars    all of them         > 28 coefficients of eight wrong deformations
    turn_cylinder   nothing             > JC, DC, MHD and GSF against the angle
"""

from dataclasses import dataclass
from typing import ClassVar

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.problem.outcome import Outcome
from palpate.workers.tasks.task_store import TaskStore
from palpate.workers.tasks.thesis.parts import Request, Spent, Watch
from palpate.workers.thesis.bar import (
    DEFORMATIONS,
    Bar,
    BarExperiment,
    bend,
    compared_bars,
    force_of,
    make_bar,
)
from palpate.workers.thesis.cylinder import CylinderRow, cylinder_experiment


@dataclass(frozen=True)
class Bend(Request):
    """Request to bend the bar; number 0 is the gold standard."""

    MODULE: ClassVar[str] = __name__

    number: int


@dataclass(frozen=True)
class Compare(Request):
    """Request to compare all bars, already bent, with the gold standard."""

    MODULE: ClassVar[str] = __name__


@dataclass(frozen=True)
class Turn(Request):
    """Request to rotate the cylinder."""

    MODULE: ClassVar[str] = __name__


@dataclass(frozen=True, slots=True)
class BentBar:
    """Result of bending a bar; stored with the displacement, in mm."""

    spent: Spent
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class ComparedBars:
    """Results of the bar experiment."""

    spent: Spent
    experiment: BarExperiment


@dataclass(frozen=True, slots=True)
class TurnedCylinder:
    """Results of the cylinder experiment."""

    spent: Spent
    rows: tuple[CylinderRow, ...]


def bend_bar(request: Bend) -> Spent:
    """Simulate one deformation of the bar."""
    if not request.part.is_finished:
        watch = Watch()
        displacement, outcome = bend(_bar(request), force_of(request.number))
        request.part.save(BentBar(watch.spent(), outcome), {"displacement_mm": displacement})
    return request.spent


def compare_bars(request: Compare) -> Spent:
    """Compare the wrong deformations with the gold standard.

    Raises
    ------
    InputError
        If the gold standard did not converge.
    """
    if not request.part.is_finished:
        watch = Watch()
        bent = {n: _bent(request, n) for n in (0, *DEFORMATIONS)}
        experiment = compared_bars(request.scale, _bar(request), bent)
        request.part.save(ComparedBars(watch.spent(), experiment), {})
    return request.spent


def turn_cylinder(request: Turn) -> Spent:
    """Compare the cylinder with itself, rotated by each of the thesis' angles."""
    if not request.part.is_finished:
        watch = Watch()
        rows = cylinder_experiment(request.scale)
        request.part.save(TurnedCylinder(watch.spent(), rows), {})
    return request.spent


def _bar(request: Request) -> Bar:
    make = lambda: make_bar(request.scale)  # noqa: E731
    return TaskStore(request.store).cached(("bar", request.scale), make)


def _bent(request: Request, number: int) -> tuple[FloatArray, Outcome]:
    record, arrays = Bend(request.store, request.scale, number).part.load(BentBar)
    return arrays["displacement_mm"], record.outcome

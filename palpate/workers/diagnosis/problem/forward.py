"""Forward solvers of a diagnosis: tetrahedra, unless an organ provides its own model."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.mechanics.fem.equilibrium import sensitivity, solve


class Forward(Protocol):
    """A solver for one kind of problem; its return values are passed back to it unchanged."""

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> Any:
        """Return an equilibrium with its ``solution``; see `mechanics.fem.equilibrium.solve`."""

    def expecting(self, at: Any, moved_mm: FloatArray) -> Any:
        """Return an equilibrium as a start, with nodes expected to move by `moved_mm`."""

    def tangents(self, at: Any, changes: Sequence[Any], tolerance: float) -> FloatArray:
        """Return derivatives of the displacement; see `mechanics.fem.equilibrium.sensitivity`."""

    def loosened(self, problem: Any, tolerance_mm: float, friction_steps: int) -> Any:
        """Return the problem with a coarser tolerance and fewer steps, if applicable.

        If no equilibrium is found from a nearby one, there are no further attempts.
        """

    def direction(self, problem: Any) -> Sequence[float]:
        """Return the direction (x, y, z) in which the body is loaded."""

    def pressed(self, at: Any) -> BoolArray | None:
        """Return a mask of the nodes that a plate presses, shape (n,); None without plates."""


class Tetrahedra:
    """The solver of `workers.mechanics.fem`; see `Forward`."""

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> Any:
        """See `Forward.equilibrium`."""
        return solve.equilibrium(model, problem, start)

    def tangents(self, at: Any, changes: Sequence[Any], tolerance: float) -> FloatArray:
        """See `Forward.tangents`."""
        return sensitivity.tangents(at, changes, tolerance)

    def expecting(self, at: Any, moved_mm: FloatArray) -> Any:
        """See `Forward.expecting`."""
        return at.expecting(moved_mm)

    def loosened(self, problem: Any, tolerance_mm: float, friction_steps: int) -> Any:
        """See `Forward.loosened`."""
        return replace(
            problem,
            tolerance_mm=max(problem.tolerance_mm, tolerance_mm),
            friction_steps=min(problem.friction_steps, friction_steps),
            restarts=False,
        )

    def direction(self, problem: Any) -> Sequence[float]:
        """See `Forward.direction`."""
        axis: Sequence[float] = problem.load.device.axis
        return axis

    def pressed(self, at: Any) -> BoolArray | None:
        """See `Forward.pressed`."""
        level, found = at.levels[-1], np.zeros(len(at.states[-1].x), np.bool_)
        for contact in level.plate_contacts(at.states[-1], at.stage):
            found[contact.nodes.index[contact.gap < 0]] = True
        return found

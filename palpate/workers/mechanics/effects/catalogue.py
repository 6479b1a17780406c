"""Catalogue of the effects of one organ."""

from dataclasses import dataclass

from palpate.storage.errors import InputError
from palpate.workers.mechanics.effects.base import Effect, Values
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.parameters import Parameter, unknown_name


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Effects to suspect when a simulated organ differs from an imaged one.

    Parameters
    ----------
    effects : tuple of Effect
        In the order in which they are applied to a problem.
    not_simulated : tuple of (str, str)
        Known or possible causes that have no effect here, each with the reason; a diagnosis
        reports "none of these" or the closest listed effect.
    """

    effects: tuple[Effect, ...]
    not_simulated: tuple[tuple[str, str], ...] = ()

    @property
    def on_body(self) -> tuple[Effect, ...]:
        """Effects on the body and its load, which a study can hold or search."""
        return tuple(e for e in self.effects if e.acts_on_body)

    @property
    def on_observation(self) -> tuple[Effect, ...]:
        """Effects on the images, which move interfaces but no tissue."""
        return tuple(e for e in self.effects if not e.acts_on_body)

    def named(self, name: str) -> Effect:
        """Return the effect of this name.

        Raises
        ------
        InputError
            If there is none; close names are suggested.
        """
        for candidate in self.effects:
            if candidate.name == name:
                return candidate
        raise InputError(unknown_name("effect", name, (e.name for e in self.effects)))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of all effects, in order."""
        return tuple(p for e in self.effects for p in e.parameters)

    def apply(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return `problem` with every effect, applied in order.

        Parameters
        ----------
        problem : Problem
            Without effects.
        values : mapping of str to float
            Internal names and units; effects without a value are left out.
        frame : Frame
            Of the undeformed body.

        Raises
        ------
        InputError
            If no effect has a parameter of that name, or a value is not admissible.
        """
        known = [p.name for p in self.parameters]
        for name in values:
            if name not in known:
                raise InputError(unknown_name("parameter of an effect", name, known))
        for each in self.effects:
            problem = each.apply(problem, {n: values[n] for n in each.names if n in values}, frame)
        return problem


NO_EFFECTS = Catalogue(())

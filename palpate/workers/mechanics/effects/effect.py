"""Effects that a model may lack: parameters that it holds at a neutral value.

An effect changes either the `Problem` or the observation. At the neutral values of its parameters
it changes nothing. A diagnosis frees them, so each has a plausible scale, and a step for
differentiating the out-of-balance force.

The effects of one organ are in its `Catalogue`; plug-ins add to it. `with_device` and
`with_constants` make the copies of a problem, with one part changed, that most effects need.
"""

import math
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Constants, Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Device, NoPlates
from palpate.workers.mechanics.model_parameters import (
    AS_IS,
    Parameter,
    Reading,
    Unit,
    Vocabulary,
    unknown_name,
)
from palpate.workers.plugins import Plugin, plugins

Family = Literal[
    "loading",
    "plate geometry",
    "boundary",
    "global material",
    "local stiffness",
    "growth",
    "observation",
]
"""Families of similar effects: data often distinguish families but not their members."""

Values = Mapping[str, float]
Transform = Callable[[Problem, Values, Frame], Problem]
Columns = Callable[[FloatArray, FloatArray, IntArray, Frame], FloatArray]
Truth = Callable[[Mapping[str, Any]], dict[str, float]]

ANY = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Place:
    """Region in which an effect at one place is searched.

    Parameters
    ----------
    names : tuple of str
        Names of the parameters for the offsets from the middle of the body along x, y and z,
        then for the radius if several radii are tried.
    on : {"inside", "boundary"}
        Where the place may be.
    radii_mm : tuple of float
        Radii to try; empty to keep the neutral one.
    """

    names: tuple[str, ...]
    on: Literal["inside", "boundary"]
    radii_mm: tuple[float, ...] = ()

    @property
    def offsets(self) -> tuple[str, ...]:
        """Names of the offsets from the middle of the body along x, y and z."""
        return self.names[:3]

    def positions_mm(self, centre_mm: Triple) -> dict[str, tuple[str, float]]:
        """Return the coordinates in the scans that correspond to the offsets.

        Parameters
        ----------
        centre_mm : tuple of float
            Middle of the body.

        Returns
        -------
        dict of str to (str, float)
            For each offset the name of its coordinate, with unit, and the shift to add.
        """
        return {
            name: (f"{name[:-1]}position_{name[-1]}_mm", along)
            for name, along in zip(self.offsets, centre_mm, strict=True)
        }


@dataclass(frozen=True, slots=True)
class Effect:
    """Physical effect that a model may lack.

    Parameters
    ----------
    name : str
        The field's term, such as "gravity_change".
    family : Family
    summary : str
        One sentence for a report.
    parameters : tuple of Parameter
        Their neutral values are numbers. A parameter whose admissible interval begins at
        its neutral value is one-sided.
    prior_sd : tuple of float
        Prior standard deviation of each parameter, internal units; of the half-normal
        where it is one-sided.
    steps : tuple of float
        Step of each parameter for differentiating the out-of-balance force, internal units.
    transform : callable
        Maps problem, values of all parameters and frame of the body to the problem
        with the effect. An effect on the observation returns the problem itself.
    references : tuple of str
        Evidence that the effect matters.
    observation : callable, optional
        For an effect on the observation: maps points, normals, tissues and frame to
        the shift of the observed interface for one unit of each parameter, shape
        (k, parameters); see `shift`.
    if_present : tuple of (float, float), optional
        For an effect whose size is known if it acts at all, such as the weight of a body:
        mean and standard deviation of each parameter in that case. Screening still uses
        the scale of `prior_sd`; a refit uses this one.
    sees : {"points", "moves", "arms", "cells"}
        Points passed to such an effect: current positions, displacements, or displacements
        of the end of a 1 mm arm at each point relative to its foot. "cells": displacements, for
        an effect on the readings of load cells only; the others do not change these.
    place : Place, optional
        For an effect that acts at one place. Parameters before those of the place are then its
        sizes; where they are neutral, the others change nothing, so the place is first searched
        on a grid.
    is_slow : bool
        Whether its tasks take several times as long as other effects' tasks and are
        therefore submitted first. Default False.
    follows_path : bool
        Whether it depends on the load path, as friction does. It is then solved in load
        steps, and its derivative comes from a second simulation. Default False: the final
        state is enough, and its derivative is a tangent.
    moves_scan : bool
        Whether its parameters are 3 shifts in mm and 3 rotations in degrees of the whole scan.
        Points are then moved before they are compared with the scan. Default False: the
        residuals change by `shift`.
    is_mapped : bool
        Whether a report shows a map of the places where stiffer or softer tissue would explain
        the residuals. Its first parameter is that stiffness, and its `place` is inside the body.
        Default False.
    holds_body : bool
        Whether it keeps a body from drifting sideways between frictionless plates, so that a
        plan recommends it for a body that nothing else holds. Default False.
    is_confounded : bool
        Whether free stiffnesses explain it completely, so that a diagnosis cannot identify it.
        Default False.
    is_in_law : bool
        Whether the shape constants of a chosen material law describe the same thing, so that it is
        not suspected where every tissue has such a law. Default False.
    searched_as : tuple of str
        Parameters of a study that describe the same thing under other names; an effect is not
        suspected if the study searches one of them. Default empty: only its own names.
    organs : tuple of str
        Organs to which it is added when another distribution provides it as an entry point of
        the group ``palpate.effects``: ``"breast"``, ``"cornea"``, ``"specimen"``.
    truth : callable, optional
        Maps the parameters of a blind case to the equivalent parameters of this effect, under
        their public names. Default None: a blind case has no equivalent.

    Raises
    ------
    InputError
        If a parameter has no neutral value; if a scale or a step is missing or not
        positive; or if a mapped effect has no place inside the body.
    """

    name: str
    family: Family
    summary: str
    parameters: tuple[Parameter, ...]
    prior_sd: tuple[float, ...]
    steps: tuple[float, ...]
    transform: Transform
    references: tuple[str, ...]
    observation: Columns | None = None
    if_present: tuple[tuple[float, float], ...] = ()
    sees: Literal["points", "moves", "arms", "cells"] = "points"
    place: Place | None = None
    is_slow: bool = False
    follows_path: bool = False
    moves_scan: bool = False
    is_mapped: bool = False
    holds_body: bool = False
    is_confounded: bool = False
    is_in_law: bool = False
    searched_as: tuple[str, ...] = ()
    organs: tuple[str, ...] = ()
    truth: Truth | None = None

    def __post_init__(self) -> None:
        if self.is_mapped and (self.place is None or self.place.on != "inside"):
            raise InputError(f"The effect {self.name} needs a place inside the body for a map.")
        scales = {"prior_sd": self.prior_sd, "steps": self.steps}
        for what, numbers in scales.items():
            if len(numbers) != len(self.parameters) or not all(n > 0 for n in numbers):
                raise InputError(
                    f"The effect {self.name} needs {what} > 0 for each of its "
                    f"{len(self.parameters)} parameters, found {numbers}."
                )
        loose = [p.name for p in self.parameters if p.neutral is None]
        if loose:
            raise InputError(
                f"The effect {self.name} needs a neutral value for {', '.join(loose)}."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Return the internal names of the parameters, in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def acts_on_body(self) -> bool:
        """Whether it changes the problem, so that a study can hold or search it."""
        return self.observation is None

    @property
    def is_one_sided(self) -> bool:
        """Whether some parameter begins at its neutral value.

        Such an effect is steepest there and then saturates.
        """
        return any(one_sided(p) for p in self.parameters)

    @property
    def is_proportional(self) -> bool:
        """Whether its influence is proportional to its parameters.

        This excludes effects at one place, and effects that begin at their neutral value.
        """
        return self.place is None and not self.is_one_sided

    def is_searched(self, names: Container[str]) -> bool:
        """Test whether a study of these parameters searches the effect."""
        return any(name in names for name in (*self.names, *self.searched_as))

    @property
    def size_count(self) -> int:
        """Return the number of leading parameters that have an influence on their own."""
        return self.names.index(self.place.names[0]) if self.place else len(self.names)

    @property
    def neutral(self) -> dict[str, float]:
        """Return the values at which nothing changes."""
        return {p.name: p.neutral for p in self.parameters if p.neutral is not None}

    @property
    def plausible(self) -> dict[str, float]:
        """Return values of all parameters one standard deviation from neutral."""
        return {
            name: self.neutral[name] + sd
            for name, sd in zip(self.names, self.prior_sd, strict=True)
        }

    def complete(self, values: Values) -> dict[str, float]:
        """Return `values` with neutral values for the missing parameters.

        Raises
        ------
        InputError
            If a name is unknown or a value not admissible.
        """
        return Vocabulary(self.parameters).complete(values)

    def apply(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return `problem` with the effect; the problem itself if all values are neutral.

        Parameters
        ----------
        problem : Problem
        values : mapping of str to float
            Internal names and units; missing ones are neutral.
        frame : Frame
            Of the undeformed body.

        Raises
        ------
        InputError
            If a name is unknown or a value not admissible.
        """
        full = self.complete(values)
        return problem if full == self.neutral else self.transform(problem, full, frame)

    def acts_on(self, problem: Problem, frame: Frame) -> bool:
        """Test whether the effect changes this problem: without plates, no plate can tilt."""
        if self.observation is not None:
            return True
        return self.apply(problem, self.plausible, frame) != problem

    def changes(
        self, problem: Problem, frame: Frame, at: Values | None = None
    ) -> tuple[Change, ...]:
        """Return pairs of problems whose forces differ by a step of one parameter.

        Parameters
        ----------
        problem : Problem
            Without the effect.
        frame : Frame
        at : mapping of str to float, optional
            Values at which to differentiate; missing ones are neutral.

        Returns
        -------
        tuple of Change
            One for each parameter, for `mechanics.fem.equilibrium_sensitivity.tangents` at the
            equilibrium of ``apply(problem, at, frame)``. Differences are central
            where both sides are admissible, else one-sided.

        Raises
        ------
        InputError
            If `at` names an unknown parameter or a value is not admissible.
        """
        centre = self.complete(at or {})
        return tuple(
            self._change(problem, frame, centre, parameter, step)
            for parameter, step in zip(self.parameters, self.steps, strict=True)
        )

    def shift(
        self,
        points: FloatArray,
        normals: FloatArray,
        tissues: IntArray,
        values: Values,
        frame: Frame,
    ) -> FloatArray:
        """Return the outward shift of the observed interface due to the effect.

        It is linear in the values; `observation` is its derivative.

        Parameters
        ----------
        points, normals : ndarray, shape (k, 3)
            On the interfaces, in mm, or as the effect `sees` them; unit normals out of the tissue.
        tissues : ndarray of int, shape (k,)
            The `Tissue` that each interface encloses.
        values : mapping of str to float
        frame : Frame

        Returns
        -------
        ndarray, shape (k,)
            Along the normals, in mm; zero for an effect on the problem.

        Raises
        ------
        InputError
            If a name is unknown or a value not admissible.
        """
        if self.observation is None:
            return np.zeros(len(points))
        full = self.complete(values)
        columns = self.observation(points, normals, tissues, frame)
        return np.asarray(columns @ np.array([full[name] for name in self.names]))

    def _change(
        self, problem: Problem, frame: Frame, centre: Values, parameter: Parameter, step: float
    ) -> Change:
        high, low = parameter.either_side(centre[parameter.name], step)
        plus, minus = (
            self.apply(problem, {**centre, parameter.name: value}, frame) for value in (high, low)
        )
        return Change(plus, minus, high - low)


def one_sided(parameter: Parameter) -> bool:
    """Test whether a parameter's neutral value is its lower bound."""
    return parameter.neutral == parameter.admissible[0]


def two_sided(
    name: str,
    unit: Unit,
    reach: float,
    description: str,
    neutral: float = 0.0,
    reading: Reading = AS_IS,
) -> Parameter:
    """Return a parameter of either sign, searched within ``reach`` of `neutral`."""
    lower, upper = neutral - reach, neutral + reach
    return Parameter(
        name, unit, lower, upper, neutral, description, admissible=ANY, reading=reading
    )


def renamed(**names: str) -> Truth:
    """Return a `truth` for parameters that only have other names in a blind case.

    Parameters
    ----------
    **names : str
        The parameter's name in the case, by its public name.
    """
    return partial(_read_renamed, names)


def from_zero(
    name: str,
    unit: Unit,
    reach: float,
    description: str,
    limit: float = math.inf,
    reading: Reading = AS_IS,
) -> Parameter:
    """Return a parameter that is zero or positive, searched up to `reach` and below `limit`."""
    return Parameter(
        name,
        unit,
        0.0,
        reach,
        0.0,
        description,
        admissible=(0.0, limit),
        open_lower=False,
        reading=reading,
    )


def _read_renamed(names: Mapping[str, str], given: Mapping[str, Any]) -> dict[str, float]:
    return {own: float(given[other]) for own, other in names.items()}


def with_device(problem: Problem, change: Callable[[Device], Device]) -> Problem:
    """Return `problem` with its plates changed, or the problem itself without plates."""
    if isinstance(problem.load, NoPlates):
        return problem
    return replace(problem, load=replace(problem.load, device=change(problem.load.device)))


def with_constants(problem: Problem, change: Callable[[Constants], Constants]) -> Problem:
    """Return `problem` with the constants of every tissue changed."""
    return replace(
        problem, constants={tissue: change(c) for tissue, c in problem.constants.items()}
    )


def sum_of_vectors(first: Triple, second: Triple) -> Triple:
    """Return the sum of two vectors."""
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def unchanged_problem(problem: Problem, values: Mapping[str, float], frame: Frame) -> Problem:
    """Return the problem itself: only the observation changes."""
    return problem


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


def plugged_effects(organ: str) -> tuple[Effect, ...]:
    """Return the effects that plug-ins add to an organ, sorted by name.

    Raises
    ------
    InputError
        If a plug-in cannot be imported.
    """
    loaded: list[Effect] = [p.load() for p in plugins("effects").values() if not p.is_own]
    return tuple(effect for effect in loaded if organ in effect.organs)


def acting_plugins(values: Mapping[str, float]) -> tuple[Plugin, ...]:
    """Return the plug-ins whose effects change something at these values.

    Parameters
    ----------
    values : mapping of str to float
        Internal names and units.
    """
    return tuple(
        plugin
        for plugin, effect in _foreign()
        if any(values.get(name, neutral) != neutral for name, neutral in effect.neutral.items())
    )


def plugins_of_parameters(names: Container[str]) -> tuple[Plugin, ...]:
    """Return the plug-ins whose effects have any of these parameters, internal names."""
    return tuple(plugin for plugin, e in _foreign() if any(name in names for name in e.names))


def without_idle_plugins(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values without plug-in effects that change nothing.

    The digest of an evaluation thus does not depend on plug-ins that it does not use.
    """
    idle = {
        name
        for _, effect in _foreign()
        if all(values.get(n, neutral) == neutral for n, neutral in effect.neutral.items())
        for name in effect.names
    }
    return {name: value for name, value in values.items() if name not in idle}


def _foreign() -> list[tuple[Plugin, Effect]]:
    return [(p, p.load()) for p in plugins("effects").values() if not p.is_own]

"""Copies of a problem with one part changed."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import Device, NoPlates


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


def plus(first: Triple, second: Triple) -> Triple:
    """Return the sum of two vectors."""
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def unchanged(problem: Problem, values: Mapping[str, float], frame: Frame) -> Problem:
    """Return the problem itself: only the observation changes."""
    return problem

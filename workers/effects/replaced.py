"""Replacing one part of a problem and keeping the rest."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from storage.values import Triple
from workers.fem.fields import Frame
from workers.fem.loads import Device, NoPlates
from workers.fem.problem import Constants, Problem


def with_device(problem: Problem, change: Callable[[Device], Device]) -> Problem:
    """`problem` with its plates changed; the problem itself where there are none."""
    if isinstance(problem.load, NoPlates):
        return problem
    return replace(problem, load=replace(problem.load, device=change(problem.load.device)))


def with_constants(problem: Problem, change: Callable[[Constants], Constants]) -> Problem:
    """`problem` with the constants of every tissue changed."""
    return replace(
        problem, constants={tissue: change(c) for tissue, c in problem.constants.items()}
    )


def plus(first: Triple, second: Triple) -> Triple:
    """Sum of two vectors."""
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def unchanged(problem: Problem, values: Mapping[str, float], frame: Frame) -> Problem:
    """The problem itself: what changes is how the body is seen."""
    return problem

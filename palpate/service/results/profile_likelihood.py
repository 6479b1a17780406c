r"""The profile likelihood of a constant: the best fit with the constant held at other values.

At each value the other constants are refitted by Gauss steps from the point predicted by the
derivatives at the best candidate. The rise of the sum of squares above its minimum, in units
of the noise, is chi-squared with one degree of freedom (S. S. Wilks 1938): below 2.71 the value
is in the 90 % interval. Unlike an interval from the derivatives, a profile includes curvature.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import TaskError
from palpate.service.search.least_squares_search import squares_of
from palpate.service.search.search_interface import FloatArray, LogSpace
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.task_requests import StudyWork, Tasks
from palpate.storage.best_candidate import best_of, minimised
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.values import FitJson
from palpate.workers.mechanics.model_parameters import unknown_name
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.trust_region_descent import (
    Descent,
    Tolerance,
    advance_descent,
    begin_descent,
    with_held,
)

# The 90 % quantile of chi-squared with one degree of freedom.
CHI2_90 = 2.706
# Range of the values in standard deviations to either side, within the searched interval.
REACH = 3.0
ROUNDS = 3
# Steps with a smaller predicted reduction are skipped, in units of the noise.
TOLERANCE = Tolerance(0.02)


@dataclass(frozen=True)
class ProfilePoint:
    """The best fit with one constant held.

    Parameters
    ----------
    value : float
        The held value, in external units.
    rise : float or None
        Rise of the sum of squares above its minimum, in units of the noise; None if the
        simulation failed.
    genes : mapping of str to float
        All refitted constants, in external units.
    score : float or None
        Minimised score of the fit.
    """

    value: float
    rise: float | None
    genes: Mapping[str, float]
    score: float | None


@dataclass(frozen=True)
class Profile:
    """The profile of one constant.

    Parameters
    ----------
    gene : str
    points : sequence of ProfilePoint
        In ascending order of the value.
    lower, upper : float or None
        Values at which the rise reaches 2.71; None if it does not.
    """

    gene: str
    points: tuple[ProfilePoint, ...]
    lower: float | None
    upper: float | None


def profile_of(
    spec: StudySpec, log: StudyLog, tasks: Tasks, dispatcher: Dispatcher, gene: str, count: int
) -> Profile:
    """Return the profile of a constant in a completed study.

    Parameters
    ----------
    gene : str
        The constant as named in the study file, or without its unit.
    count : int
        Number of values, >= 3.

    Raises
    ------
    InputError
        If the study has no such constant, or no derivatives.
    """
    best, derivatives, session = best_of(log.endings), log.identification, log.last_session
    if best is None or session is None or derivatives is None or derivatives.fit is None:
        why = (
            derivatives.reason
            if derivatives is not None and derivatives.reason
            else "it has not ended yet"
        )
        raise InputError(f"The study {spec.name} has no derivatives to start a profile: {why}.")
    index = _index(spec, gene)
    work = StudyWork(
        spec, tasks, open_store(session.store), dispatcher, session.prepared,
        session.target["target"],
    )  # fmt: skip
    return _Profiler(spec, work, best.genes, derivatives.fit, index).run(count)


class _Profiler:
    def __init__(
        self, spec: StudySpec, work: StudyWork, best: Mapping[str, float], fit: FitJson, index: int
    ) -> None:
        self.work, self.index = work, index
        self.space = spec.search.space
        self.logs = LogSpace(self.space)
        self.names = spec.fitted_names
        self.at = self.logs.coordinates(np.array([best[n] for n in self.space.names]))
        self.here = self._squares(fit)
        self.others = [i for i in range(self.space.dimension) if i != index]

    def run(self, count: int) -> Profile:
        values, box = self._values(count), self.logs.box
        starts = [with_held(self.here, self.at, self.index, v, REACH, box) for v in values]
        descents = [begin_descent(at[self.others], REACH) for at in starts]
        scores: list[float | None] = [None] * count
        for _ in range(ROUNDS):
            self._advance(values, descents, scores)
        least = min(self.here.cost, *(descent.cost for descent in descents))
        points = tuple(map(self._point, values, descents, scores, [least] * count))
        known = [(p.value, p.rise) for p in points if p.rise is not None]
        centre = float(self.logs.genes(self.at)[self.index])
        lower = _crossing([(v, r) for v, r in known if v <= centre][::-1], centre)
        upper = _crossing([(v, r) for v, r in known if v >= centre], centre)
        return Profile(self.space.names[self.index], points, lower, upper)

    def _values(self, count: int) -> FloatArray:
        """Return the coordinates at which the constant is held, shape (count,)."""
        inverse = np.linalg.pinv(self.here.hessian)
        sd = float(np.sqrt(max(inverse[self.index, self.index], 0.0) * self.here.noise))
        i = self.index
        low = max(self.logs.lower[i], self.at[i] - REACH * sd)
        high = min(self.logs.upper[i], self.at[i] + REACH * sd)
        return np.linspace(low, high, count)

    def _advance(
        self, values: FloatArray, descents: list[Descent], scores: list[float | None]
    ) -> None:
        """Evaluate the trial of each running descent, and the scores of its best points."""
        box = self.logs.box.part(self.others)
        calls = [
            (k, (self.work.request(self._genes(values[k], descent.trial), derivatives=True),))
            for k, descent in enumerate(descents)
            if descent.state == "running"
        ]
        for ending in self.work.dispatcher.run(self.work.tasks.evaluate, calls):
            if ending.kind == "lost":
                raise TaskError(f"a worker was lost: {ending.reason}. Run the same command again.")
            k, result = ending.key, ending.value or {}
            fit, score, before = result.get("fit"), result.get("score"), descents[k]
            there = None if fit is None else self._squares(fit).part(self.others)
            descents[k] = advance_descent(before, there, box, TOLERANCE, ROUNDS)
            if descents[k].cost < before.cost:
                scores[k] = None if score is None else minimised(score)

    def _genes(self, value: float, others: FloatArray) -> dict[str, float]:
        """Return all constants, in external units, given the coordinates."""
        return self.space.as_dict(self.logs.genes(np.insert(others, self.index, value)))

    def _point(
        self, value: float, descent: Descent, score: float | None, least: float
    ) -> ProfilePoint:
        genes = self._genes(value, descent.at)
        rise = None if descent.here is None else (descent.cost - least) / self.here.noise
        return ProfilePoint(genes[self.space.names[self.index]], rise, genes, score)

    def _squares(self, fit: FitJson) -> NormalEquations:
        order = [fit["parameters"].index(name) for name in self.names.inside]
        return squares_of(fit, self.logs, order, np.asarray(self.names.per_inside))


def _crossing(points: Sequence[tuple[float, float]], centre: float) -> float | None:
    """Return the value at which the rise reaches `CHI2_90`, going outwards from the centre."""
    before, rise = centre, 0.0
    for value, higher in points:
        if higher >= CHI2_90:
            # The rise is nearly a parabola, so its root is interpolated.
            a, b, c = np.sqrt(max(rise, 0.0)), np.sqrt(higher), np.sqrt(CHI2_90)
            return float(before + (value - before) * (c - a) / (b - a))
        before, rise = value, higher
    return None


def _index(spec: StudySpec, gene: str) -> int:
    """Return the position of a gene, named with or without its unit."""
    names = list(spec.search.parameters)
    inside = [spec.case.parameters.at_door(name).name for name in names]
    for known in (names, inside):
        if gene in known:
            return known.index(gene)
    raise InputError(unknown_name("searched constant", gene, names))

"""The functions that a study sends to the workers, and their requests."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from palpate.service.cluster.task_dispatch import Task, TaskRunner
from palpate.service.study.study_keys import StudySpec
from palpate.storage.store import Store
from palpate.storage.values import (
    BodyFacts,
    EvaluationRequest,
    EvaluationResult,
    FreeParameter,
    PreparedBody,
    PreparedLevel,
    PreparedTarget,
    Scores,
)
from palpate.workers.organs.organ_plugins import organ_spec
from palpate.workers.tasks import study_tasks as evaluation_tasks
from palpate.workers.tasks.evaluation_deadline import evaluate_within
from palpate.workers.tasks.study_tasks import find

# Finer than any voxel, so bodies keep their own voxels.
FINEST_MM = 1e-6


@dataclass(frozen=True)
class Tasks:
    """The functions sent to the workers; see `workers.tasks.study_tasks`."""

    prepare: Callable[..., PreparedBody] = evaluation_tasks.prepare_case
    target: Callable[..., PreparedTarget] = evaluation_tasks.make_target
    evaluate: Callable[..., EvaluationResult] = evaluation_tasks.evaluate
    digest: Callable[..., str] = evaluation_tasks.evaluation_digest
    keep_volume: Callable[..., str] = evaluation_tasks.keep_volume
    compare: Callable[..., Mapping[str, Scores]] = evaluation_tasks.score_bodies
    level: Callable[..., PreparedLevel] = evaluation_tasks.prepare_level
    find: Callable[..., Mapping[str, Any]] = find


@dataclass(frozen=True)
class Resolution:
    """Body, mesh and target of one level, and the case with that mesh."""

    case: Mapping[str, Any]
    body: PreparedBody
    target: str


class StudyWork:
    """The requests of one study whose body and target are stored.

    Parameters
    ----------
    spec : StudySpec
    tasks : Tasks
    store : Store
    dispatcher : TaskRunner
    body : PreparedBody
    target : str
        Digest of the target.
    """

    def __init__(
        self,
        spec: StudySpec,
        tasks: Tasks,
        store: Store,
        dispatcher: TaskRunner,
        body: PreparedBody,
        target: str,
    ) -> None:
        self.spec, self.tasks, self.store, self.dispatcher = spec, tasks, store, dispatcher
        self.score = spec.score.model_dump(mode="json")
        own = Resolution(spec.case.model_dump(mode="json"), body, target)
        self._resolutions: dict[int | None, Resolution] = {None: own}

    def resolution(self, level: int | None) -> Resolution:
        """Return body, mesh and target of a level, computing them if they are missing."""
        if level is not None and level not in self._resolutions:
            own, coarse = self._resolutions[None], self.spec.levels[level]
            where = coarse.spacing_mm, coarse.nodes, str(self.store.root)
            made = self.dispatcher.call(self.tasks.level, own.case, own.body, own.target, *where)
            self._resolutions[level] = Resolution(made["case"], made["prepared"], made["target"])
        return self._resolutions[level]

    def request(
        self, genes: Mapping[str, float], level: int | None = None, *, derivatives: bool = False
    ) -> EvaluationRequest:
        """Return the request of one evaluation, including its digest."""
        constants, resolution = self.spec.constants_of(genes), self.resolution(level)
        request: EvaluationRequest = {
            "store": str(self.store.root),
            "case": resolution.case,
            "prepared": resolution.body,
            "target": resolution.target,
            "constants": constants,
            "score": self.score,
            "keep_volume": self.spec.keep == "all",
        }
        more = [self.spec.free_parameters] if derivatives else []
        if more:
            request["free"] = more[0]
        name = self.tasks.digest(
            resolution.case, resolution.body, resolution.target, constants, self.score, *more
        )
        request["digest"] = name
        return request

    def nuisances_request(self, genes: Mapping[str, float]) -> EvaluationRequest | None:
        """Return a request for derivatives with respect to the nuisance parameters.

        None if the organ has no nuisance parameters.
        """
        case = self.spec.case
        searched = self.spec.free_parameters
        names = {p["name"] for p in searched}
        stated = case.parameters.from_door(case.constants)
        imaged = self.spec.target.constants is None
        nuisances = organ_spec(case.organ).nuisances
        if nuisances is None:
            return None
        known = nuisances(case, imaged)
        free = [nuisance.free for nuisance in known if nuisance.name not in names]
        free = [p for p in free if not stated.get(p["name"])]
        if not free:
            return None
        return self._differentiated(genes, self.resolution(None), [*searched, *free])

    def on_other_mesh(
        self, genes: Mapping[str, float], nodes: int
    ) -> tuple[EvaluationRequest, BodyFacts]:
        """Return the request of an evaluation on a mesh of about `nodes` nodes, and its facts."""
        own = self._resolutions[None]
        where = FINEST_MM, nodes, str(self.store.root)
        made = self.dispatcher.call(self.tasks.level, own.case, own.body, own.target, *where)
        at = Resolution(made["case"], made["prepared"], made["target"])
        request = self._differentiated(genes, at, self.spec.free_parameters)
        return request, made["prepared"]["facts"]

    def _differentiated(
        self, genes: Mapping[str, float], at: Resolution, free: list[FreeParameter]
    ) -> EvaluationRequest:
        constants = self.spec.constants_of(genes)
        return {
            "store": str(self.store.root),
            "case": at.case,
            "prepared": at.body,
            "target": at.target,
            "constants": constants,
            "score": self.score,
            "keep_volume": False,
            "free": free,
            "digest": self.tasks.digest(at.case, at.body, at.target, constants, self.score, free),
        }

    @property
    def evaluate(self) -> Task:
        """Return the task that evaluates a candidate, with a deadline if there is one."""
        return self.tasks.evaluate if self.spec.deadline_s is None else evaluate_within

    def arguments(self, request: EvaluationRequest) -> tuple[Any, ...]:
        """Return the arguments of `evaluate`."""
        deadline_s = self.spec.deadline_s
        return (request,) if deadline_s is None else (deadline_s, self.tasks.evaluate, request)

    def compare_with_target(self, at: Resolution, volume: str) -> Mapping[str, Scores]:
        """Score a stored volume against the target, tissue by tissue."""
        store = str(self.store.root)
        return self.dispatcher.call(
            self.tasks.compare, at.case, store, at.target, volume, self.score
        )

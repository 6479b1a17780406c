"""Dask tasks of a study: a small record in, a small record out.

::

    prepare_case    a case                       > body and mesh in the store
    make_target     a case and a target          > the deformed body to be matched
    prepare_level   a body and its target        > both with coarser voxels, and a coarser mesh
    evaluate        a candidate                  > field, score and record in the store
    keep_volume     a finished evaluation        > its deformed body in the store
    score_bodies    two stored bodies            > the score of each part
    find            a fitted body                > findings; see `organ_plugins.Findings`

Every task is idempotent: stored results are not computed again. Arrays are never sent;
workers read them by digest and cache the most recent in `workers.resources.CACHE`. Tasks
only load and save; `workers.tasks.pipeline` does the computation in between. Constants in
these records have internal names and units, ``{"E_fat": 0.01}``.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import digest, dumps, loads, to_plain
from palpate.storage.store import Store, load_evaluation, open_store, save_evaluation
from palpate.storage.stored_arrays import load_field, save_field
from palpate.storage.values import (
    EvaluationRequest,
    EvaluationResult,
    FreeParameter,
    PreparedBody,
    PreparedLevel,
    PreparedTarget,
    Scores,
    SpecJson,
)
from palpate.workers.common_keys import CaseSpec, Door, ScoreSpec, validated
from palpate.workers.mechanics.effects.effect import acting_plugins, without_idle_plugins
from palpate.workers.organs.organ_plugins import (
    DEFAULT,
    findings_of,
    organ_modules,
    organ_named,
    organ_spec,
)
from palpate.workers.organs.organ_protocol import Organ, OrganSpec, Solution
from palpate.workers.plugins import plugin
from palpate.workers.resources import worker_name
from palpate.workers.tasks import pipeline
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.pipeline import Watch
from palpate.workers.tasks.task_store import BodyStore


def case_organ(case: SpecJson) -> Organ[Any, Any, Any]:
    """Return the organ of a case.

    Raises
    ------
    InputError
        If there is no such organ.
    """
    return organ_named(str(case.get("organ", DEFAULT)))


def spec_of(case: SpecJson) -> OrganSpec:
    """Return the specification class of a case's organ; see `case_organ`."""
    return organ_spec(str(case.get("organ", DEFAULT)))


def case_of(case: SpecJson) -> CaseSpec:
    """Validate a case with the model of its organ.

    Raises
    ------
    InputError
        If it is invalid.
    """
    spec: CaseSpec = _validated(spec_of(case).case, dumps(case), "The case")
    return spec


def score_of(case: SpecJson, score: SpecJson | None) -> ScoreSpec:
    """Validate a score with the model of a case's organ; see `case_of`."""
    how: ScoreSpec = _validated(spec_of(case).score, dumps(score or {}), "The score")
    return how


@lru_cache(maxsize=64)  # the candidates of a study have the same case and score
def _validated(model: type[Door], text: str, where: str) -> Any:
    return validated(model, loads(text), where)


def prepare_case(case: SpecJson, store: str) -> PreparedBody:
    """Add the undeformed body and its mesh to the store.

    Parameters
    ----------
    case : mapping
        Case, as serialised by `CaseSpec`.
    store : str
        Location of the store.

    Raises
    ------
    InputError
        If the case is invalid, or its image cannot be read or meshed.
    """
    organ, spec = case_organ(case), case_of(case)
    bodies = BodyStore(open_store(store), organ)
    body = bodies.bring_body(spec.reference)
    mesh, facts = bodies.bring_mesh(body, spec)
    organ.check(spec, bodies.body(body), facts)
    return {"volume": body, "mesh": mesh, "facts": facts}


def prepare_level(
    case: SpecJson, prepared: PreparedBody, target: str, spacing_mm: float, nodes: int, store: str
) -> PreparedLevel:
    """Add body and target with coarser voxels, and a mesh with fewer nodes, to the store.

    Raises
    ------
    InputError
        If the body cannot be meshed so coarsely.
    """
    organ = case_organ(case)
    spec = organ.coarse_case(case_of(case), nodes)
    bodies = BodyStore(open_store(store), organ)
    body = bodies.coarse(prepared["volume"], spacing_mm)
    coarse_target = bodies.coarse(target, spacing_mm)
    mesh, facts = bodies.bring_mesh(body, spec)
    return {
        "case": spec.model_dump(mode="json"),
        "prepared": {"volume": body, "mesh": mesh, "facts": facts},
        "target": coarse_target,
    }


def make_target(case: SpecJson, target: SpecJson, store: str) -> PreparedTarget:
    """Add the deformed body to be matched to the store.

    A simulated target takes its constants from `target`, then from the case; an image is read and
    its labels are mapped to tissues.

    Raises
    ------
    InputError
        If the target is invalid, or its simulation does not converge.
    """
    organ = case_organ(case)
    wanted = validated(spec_of(case).target, target, "The target")
    if wanted.constants is None:
        bodies = BodyStore(open_store(store), organ)
        name = bodies.bring_body(wanted)
        if not wanted.is_aligned:
            return {"target": name, "kind": "image"}
        asked = case_of(case)
        name, motion = bodies.bring_aligned(name, bodies.bring_body(asked.reference), asked)
        return {"target": name, "kind": "image", "motion": motion}
    spec = organ.simulated_case(case_of(case), wanted)
    made = simulate_once(
        spec.model_dump(mode="json"), spec.parameters.from_door(wanted.constants), store
    )
    volume = made.get("volume")
    if made["status"] != "done" or volume is None:
        raise InputError(
            f"The target cannot be simulated: {made['reason']}. Choose other constants, a smaller "
            "load or another mesh."
        )
    return {
        "target": volume,
        "kind": "simulated",
        "outcome": made["outcome"],
        "constants": made["constants"],
        "seconds": made["seconds"],
    }


def simulate_once(case: SpecJson, constants: Mapping[str, float], store: str) -> EvaluationResult:
    """Deform the body of a case with these constants, without a comparison.

    Returns
    -------
    dict
        ``digest``, under which the field is stored; ``volume``, the digest of the
        deformed body, derived from its content (None if diverged); otherwise as for
        `evaluate`.
    """
    spec = case_of(case)
    bodies = BodyStore(open_store(store), case_organ(case))
    prepared = prepare_case(case, store)
    values = spec.complete(constants)
    name = digest("simulation", *_dependencies(spec, prepared, values))
    done = load_evaluation(bodies.store, name)
    if done is None or not _has(bodies, done.get("volume")):
        watch = Watch()
        with watch.stage("load"):
            setup = bodies.setup(spec, _digests(prepared))
        evaluation = pipeline.evaluate(setup, values, watch)
        volume = None
        if evaluation.deformed is not None:
            volume = bodies.add(evaluation.deformed, {"kind": "simulated", "constants": values})
        result = simulation_result(name, values, evaluation.solution, watch)
        result["volume"] = volume
        done = save_simulation(bodies.store, result, evaluation.solution)
    return done


def evaluate(request: EvaluationRequest) -> EvaluationResult:
    """Simulate one candidate and compare it with the target.

    Returns
    -------
    dict
        ``score`` is None if diverged and may contain -inf; ``reused`` is True if the result was
        already stored; ``seconds`` holds the time of each stage.

    Raises
    ------
    InputError
        If the request is invalid.
    StoreError
        If the driver runs another version, or the store lacks an item named in the request.
    """
    organ, spec = case_organ(request["case"]), case_of(request["case"])
    score = score_of(request["case"], request.get("score"))
    values, free = spec.complete(request["constants"]), request.get("free") or []
    name = _checked_digest(request)
    bodies = BodyStore(open_store(request["store"]), organ)
    done = load_evaluation(bodies.store, name)
    if done is not None:
        if request.get("keep_volume"):
            keep_volume(request)
        done["reused"] = True
        return done
    watch = Watch()
    with watch.stage("load"):
        setup = bodies.setup(
            spec, _digests(request["prepared"]), request["target"], score, observed=bool(free)
        )
    evaluation = pipeline.evaluate(setup, values, watch, free)
    result = simulation_result(name, values, evaluation.solution, watch)
    result["score"] = evaluation.scores
    if free:
        result["fit"] = evaluation.fit
    if request.get("keep_volume") and evaluation.deformed is not None:
        _save_body(bodies, name, evaluation.deformed, values)
    result = save_simulation(bodies.store, result, evaluation.solution)
    result["reused"] = False
    return result


def evaluation_digest(
    case: SpecJson,
    prepared: PreparedBody,
    target: str,
    constants: Mapping[str, float],
    score: SpecJson | None = None,
    free: Sequence[FreeParameter] = (),
) -> str:
    """Return the digest of everything that an evaluation depends on, the code included."""
    spec, how = case_of(case), score_of(case, score)
    parts = _dependencies(spec, prepared, spec.complete(constants), how)
    more = [list(free)] if free else []
    return digest("evaluation", *parts, target, how.model_dump(mode="json"), *more)


def keep_volume(request: EvaluationRequest) -> str:
    """Compute the deformed body of a finished evaluation from its stored field, and store it.

    Parameters
    ----------
    request : dict
        The request of the evaluation.

    Returns
    -------
    str
        The digest of both evaluation and body. A diverged evaluation has no body.

    Raises
    ------
    StoreError
        If the evaluation is not in the store.
    """
    organ, spec = case_organ(request["case"]), case_of(request["case"])
    bodies = BodyStore(open_store(request["store"]), organ)
    name = _checked_digest(request)
    done = load_evaluation(bodies.store, name)
    if done is None:
        raise StoreError(
            f"The evaluation {name} is not in the store {bodies.store.root}: run it first."
        )
    if done["status"] == "done" and not bodies.has_body(name):
        setup = bodies.setup(spec, _digests(request["prepared"]), request["target"])
        field = load_field(bodies.store, name)
        deformed = organ.deform(setup.body, setup.mesh, field, setup.target)
        _save_body(bodies, name, deformed, done["constants"])
    return name


def score_bodies(
    case: SpecJson, store: str, target: str, candidate: str, score: SpecJson | None = None
) -> Mapping[str, Scores]:
    """Compare two stored bodies part by part; see `Organ.scores_by_part`."""
    organ = case_organ(case)
    bodies = BodyStore(open_store(store), organ)
    how = score_of(case, score)
    return organ.scores_by_part(bodies.body(target), bodies.body(candidate), how)


def _dependencies(
    spec: CaseSpec,
    prepared: PreparedBody,
    values: Mapping[str, float],
    score: ScoreSpec | None = None,
) -> list[Any]:
    """Return everything a simulation depends on: bodies by content, the case, constants, code."""
    others = [*(acting.module for acting in acting_plugins(values)), *spec.plugged_modules]
    if score is not None:
        others.append(plugin("scores", score.objective).module)
    code = code_version(__name__, *organ_modules(spec.organ), *others)
    acting = without_idle_plugins(values)
    return [prepared["volume"], prepared["mesh"], spec.simulated, acting, code]


def _digests(prepared: PreparedBody) -> dict[str, str]:
    return {"volume": prepared["volume"], "mesh": prepared["mesh"]}


def _checked_digest(request: EvaluationRequest) -> str:
    name = evaluation_digest(
        request["case"],
        request["prepared"],
        request["target"],
        request["constants"],
        request.get("score"),
        request.get("free") or (),
    )
    if request.get("digest", name) != name:
        raise StoreError(
            f"The driver and this worker run different versions: they compute the digests "
            f"{request['digest']} and {name}. `palpate doctor` lists the versions; install the "
            "same one everywhere."
        )
    return name


def simulation_result(
    name: str, values: Mapping[str, float], solution: Solution, watch: Watch
) -> EvaluationResult:
    """Return the record of a simulation, without a comparison."""
    outcome = solution.outcome
    return {
        "digest": name,
        "status": "done" if outcome.converged else "diverged",
        "reason": outcome.reason,
        "outcome": outcome.as_dict(),
        "constants": dict(values),
        "seconds": dict(watch.seconds),
        "worker": worker_name(),
    }


def save_simulation(store: Store, result: EvaluationResult, solution: Solution) -> EvaluationResult:
    """Store the field first and the record last, so an existing record guarantees the rest.

    Return the result as read back from the store.
    """
    name = result["digest"]
    if np.isfinite(solution.displacement_mm).all():
        save_field(store, name, solution.displacement_mm)
    save_evaluation(store, name, result)
    return load_evaluation(store, name) or result


def _has(bodies: BodyStore, body: str | None) -> bool:
    """Return True if no body is expected or it is still in the store."""
    return body is None or bodies.has_body(body)


def _save_body(bodies: BodyStore, name: str, body: Any, values: Mapping[str, float]) -> None:
    bodies.save_body(name, body, {"kind": "evaluation", "constants": dict(values)})


def find(request: EvaluationRequest) -> dict[str, Any]:
    """Return the findings about a finished evaluation as plain values, if any."""
    organ, spec = case_organ(request["case"]), case_of(request["case"])
    module = findings_of(spec.organ)
    if module is None:
        return {}
    score = score_of(request["case"], request.get("score"))
    body, mesh = request["prepared"]["volume"], request["prepared"]["mesh"]
    bodies = BodyStore(open_store(request["store"]), organ)
    values = spec.complete(request["constants"])
    landmarks = bodies.landmarks(body, spec)
    findings = module.findings(
        bodies.model(mesh),
        spec,
        values,
        landmarks,
        score,
        bodies.body(body),
        request.get("free") or (),
    )
    return dict(to_plain(findings))

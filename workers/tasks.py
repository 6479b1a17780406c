"""What is sent to Dask: a small record in, a small record out.

::

    prepare_case    a case                       > volume and mesh in the store
    make_target     a case and a target          > the deformed body to be explained
    evaluate        a candidate                  > field, score and record in the store
    keep_volume     an evaluation that is done   > its deformed volume in the store

Every task is idempotent: what the store has is not made again. Arrays never
travel; workers read them by digest and hold those used last in `CACHE`.
Constants in these records have inside names and units, ``{"E_fat": 0.01}``.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from storage.digest import digest
from storage.errors import InputError, StoreError
from storage.evaluations import load_evaluation, save_evaluation
from storage.fields import load_field, save_field
from storage.stores import Store, open_store
from storage.values import FloatArray, Volume
from storage.volumes import has_volume, save_volume
from workers import pipeline
from workers.fem.outcome import Solution
from workers.library import Library, code_version
from workers.organs.breast import check_skin_layer
from workers.pipeline import Watch
from workers.resources import worker_name
from workers.similarity.score import Surface
from workers.spec import CaseSpec, ScoreSpec, TargetSpec, validated

Record = dict[str, Any]


def prepare_case(case: Record, store: str) -> Record:
    """Bring the undeformed body and its mesh into the store.

    Parameters
    ----------
    case : dict
        As `CaseSpec` writes it.
    store : str
        Where the store is.

    Returns
    -------
    dict
        ``volume`` and ``mesh`` (digests) and ``facts``: what body and mesh are like.

    Raises
    ------
    InputError
        If the case makes no sense, or its image cannot be read or meshed.
    """
    spec = validated(CaseSpec, case, "The case")
    library = Library(open_store(store))
    volume = library.reference(spec.reference)
    mesh, facts = library.mesh(volume, spec.mesh, spec.model)
    if spec.model.skin == "layer":
        check_skin_layer(library.volume(volume), facts["element_size_mm"])
    return {"volume": volume, "mesh": mesh, "facts": facts}


def make_target(case: Record, target: Record, store: str) -> Record:
    """Bring the deformed body that is to be explained into the store.

    A simulated target takes its constants from `target`, then from the case; an
    image is read and its labels are named.

    Returns
    -------
    dict
        ``target`` (digest) and ``kind``, "simulated" or "image"; for a simulated one
        also ``outcome``, ``constants`` and ``seconds``.

    Raises
    ------
    InputError
        If the target makes no sense, or its simulation does not converge.
    """
    wanted = validated(TargetSpec, target, "The target")
    if wanted.constants is None:
        return {"target": Library(open_store(store)).image(wanted), "kind": "image"}
    spec = validated(CaseSpec, case, "The case")
    if wanted.mesh is not None:
        spec = spec.model_copy(update={"mesh": wanted.mesh})
    made = simulate_once(
        spec.model_dump(mode="json"), spec.parameters.from_door(wanted.constants), store
    )
    if made["status"] != "done":
        raise InputError(
            f"The target cannot be simulated: {made['reason']}. Choose other constants, a "
            "smaller load or another mesh for it."
        )
    told = {key: made[key] for key in ("outcome", "constants", "seconds")}
    return {"target": made["volume"], "kind": "simulated"} | told


def simulate_once(case: Record, constants: Mapping[str, float], store: str) -> Record:
    """Deform the body of a case with these constants, compared with nothing.

    Returns
    -------
    dict
        ``digest``, under which the field is stored; ``volume``, the digest of the
        deformed body, made from its content (None when diverged); ``status``,
        ``reason``, ``outcome``, ``constants``, ``seconds``, ``worker``.
    """
    spec = validated(CaseSpec, case, "The case")
    library = Library(open_store(store))
    prepared = prepare_case(case, store)
    values = spec.complete(constants)
    name = digest("simulation", *_asked(spec, prepared, values))
    done = load_evaluation(library.store, name)
    if done is None or not _has(library.store, done["volume"]):
        watch = Watch()
        solution = _solve(library, spec, prepared, values, None, watch)
        volume = None
        if solution.outcome.converged:
            deformed = _deform(library, prepared, solution.displacement_mm, None, watch)
            volume = library.add(deformed, {"kind": "simulated", "constants": values})
        ending = _ending(name, values, solution, watch) | {"volume": volume}
        done = _save(library.store, ending, solution)
    return done


def evaluate(request: Record) -> Record:
    """Simulate one candidate and compare it with the target.

    Parameters
    ----------
    request : dict
        ``store``, ``case``, ``prepared`` (of `prepare_case`), ``target`` (digest) and
        ``constants``; optional ``score`` (as `ScoreSpec` writes it), ``keep_volume`` and
        ``digest``, which must be that of `evaluation_digest`.

    Returns
    -------
    dict
        ``digest``; ``status``, "done" or "diverged"; ``reason``; ``score`` (None when
        diverged; may hold -inf); ``outcome``; ``constants``; ``seconds`` of each stage;
        ``worker``; ``reused``, whether the store had it.

    Raises
    ------
    InputError
        If the request makes no sense.
    StoreError
        If the driver runs another version, or the store lacks what the request names.
    """
    spec = validated(CaseSpec, request["case"], "The case")
    how = validated(ScoreSpec, request.get("score") or {}, "The score")
    library = Library(open_store(request["store"]))
    prepared, target = request["prepared"], request["target"]
    name = _name_of(request)
    done = load_evaluation(library.store, name)
    if done is not None:
        if request.get("keep_volume"):
            keep_volume(request)
        return done | {"reused": True}

    values = spec.complete(request["constants"])
    watch = Watch()
    solution = _solve(library, spec, prepared, values, target, watch)
    score = None
    if solution.outcome.converged:
        with watch.stage("load"):
            against = library.scorer(target, how)
        deformed = _deform(library, prepared, solution.displacement_mm, target, watch)
        with watch.stage("score"):
            score = against.score(deformed).as_dict()
        if request.get("keep_volume"):
            _save_volume(library.store, name, deformed, values)
    ending = _ending(name, values, solution, watch) | {"score": score}
    return _save(library.store, ending, solution) | {"reused": False}


def evaluation_digest(
    case: Record, prepared: Record, target: str, constants: Mapping[str, float],
    score: Record | None = None,
) -> str:  # fmt: skip
    """The name of an evaluation: all that its result depends on, the code included."""
    spec = validated(CaseSpec, case, "The case")
    how = validated(ScoreSpec, score or {}, "The score")
    asked = _asked(spec, prepared, spec.complete(constants))
    return digest("evaluation", *asked, target, how.model_dump(mode="json"))


def keep_volume(request: Record) -> str:
    """Store the deformed volume of an evaluation that is done, made from its stored field.

    Parameters
    ----------
    request : dict
        As it was evaluated.

    Returns
    -------
    str
        The digest of evaluation and volume. A diverged evaluation has no volume.

    Raises
    ------
    StoreError
        If the evaluation is not in the store.
    """
    library = Library(open_store(request["store"]))
    name = _name_of(request)
    done = load_evaluation(library.store, name)
    if done is None:
        raise StoreError(
            f"The evaluation {name} is not in the store {library.store.root}: run it first."
        )
    if done["status"] == "done" and not has_volume(library.store, name):
        field = load_field(library.store, name)
        deformed = _deform(library, request["prepared"], field, request["target"], Watch())
        _save_volume(library.store, name, deformed, done["constants"])
    return name


def score_volumes(store: str, target: str, candidate: str, surface: Surface = "boundary") -> Record:
    """Compare two stored volumes, each tissue and the outline; see `pipeline.score_by_tissue`."""
    library = Library(open_store(store))
    return dict(
        pipeline.score_by_tissue(library.volume(target), library.volume(candidate), surface)
    )


def _asked(spec: CaseSpec, prepared: Record, values: Mapping[str, float]) -> list[Any]:
    return [
        prepared["volume"],
        prepared["mesh"],
        spec.model.model_dump(mode="json"),
        spec.load.model_dump(mode="json"),
        dict(values),
        code_version(),
    ]


def _name_of(request: Record) -> str:
    name = evaluation_digest(
        request["case"],
        request["prepared"],
        request["target"],
        request["constants"],
        request.get("score"),
    )
    if request.get("digest", name) != name:
        raise StoreError(
            f"The driver calls this evaluation {request['digest']}, this worker {name}: they run "
            "different versions. `palpate doctor` shows which; install the same everywhere."
        )
    return name


def _solve(
    library: Library, spec: CaseSpec, prepared: Record, values: Mapping[str, float],
    target: str | None, watch: Watch,
) -> Solution:  # fmt: skip
    with watch.stage("load"):
        model = library.model(prepared["mesh"])
        oblique = spec.load.oblique_deg
        body = library.extent(prepared["volume"], oblique)
        imaged = target is not None and library.imaged(target)
        held = library.extent(target, oblique) if target is not None and imaged else None
    with watch.stage("solve"):
        return pipeline.simulate(model, spec, values, body, held)


def _deform(
    library: Library, prepared: Record, displacement_mm: FloatArray, target: str | None,
    watch: Watch,
) -> Volume:  # fmt: skip
    with watch.stage("load"):
        body = library.volume(prepared["volume"])
        mesh = library.hierarchy(prepared["mesh"]).finest.mesh
        lattice = None if target is None else library.volume(target)
    with watch.stage("deform"):
        return pipeline.deform(body, mesh, displacement_mm, lattice)


def _ending(name: str, values: Mapping[str, float], solution: Solution, watch: Watch) -> Record:
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


def _save(store: Store, record: Record, solution: Solution) -> Record:
    """Store the field first, the record last: it vouches for the rest.

    What comes back is what a later reader will find.
    """
    name = record["digest"]
    if np.isfinite(solution.displacement_mm).all():
        save_field(store, name, solution.displacement_mm)
    save_evaluation(store, name, record)
    return load_evaluation(store, name) or record


def _has(store: Store, volume: str | None) -> bool:
    """Whether a volume is there, where one is expected: somebody may have removed it."""
    return volume is None or has_volume(store, volume)


def _save_volume(store: Store, name: str, volume: Volume, values: Mapping[str, float]) -> None:
    save_volume(store, name, volume, meta={"kind": "evaluation", "constants": dict(values)})

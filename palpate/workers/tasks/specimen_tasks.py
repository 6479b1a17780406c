"""Dask task of a bench specimen: a small record in, a small record out.

See `workers.tasks.study_tasks`.
"""

from collections.abc import Mapping
from typing import Any

from palpate.storage.json_digests import digest
from palpate.storage.store import load_evaluation
from palpate.storage.values import EvaluationResult, SpecJson
from palpate.workers.organs.organ_plugins import module_of, resolve
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.diagnosis_store import plugged_modules
from palpate.workers.tasks.pipeline import Watch
from palpate.workers.tasks.study_tasks import save_simulation, simulation_result
from palpate.workers.tasks.task_store import TaskStore


def simulate_specimen(
    model: str,
    spec: SpecJson,
    voxels: str | None,
    nodes: int,
    state: str,
    constants: Mapping[str, float],
    store: str,
) -> EvaluationResult:
    """Load a specimen; store the displacement.

    Parameters
    ----------
    model : str
        The class of the model, ``"module:class"``.
    spec : mapping
        The keys of the experiment.
    voxels : str or None
        Digest of the body of a mesh file.
    nodes : int
    state : str
    constants : mapping of str to float
        All constants, in internal names and units.
    store : str
        Location of the store.

    Returns
    -------
    dict
        ``digest``, under which the field is stored; otherwise as for `study_tasks.evaluate`.
    """
    kept = TaskStore(store)
    code = code_version(module_of(model), *plugged_modules())
    name = digest("specimen", spec, voxels, nodes, state, dict(constants), code)
    done = load_evaluation(kept.store, name)
    if done is None:

        def make() -> Any:
            body = None if voxels is None else kept.volume(voxels)
            return resolve(model)(spec, body, nodes)

        specimen = kept.cached(("specimen", digest(spec, voxels, nodes)), make)
        watch = Watch()
        with watch.stage("solve"):
            solution = specimen.solve(state, constants)
        result = simulation_result(name, constants, solution, watch)
        done = save_simulation(kept.store, result, solution)
    return done

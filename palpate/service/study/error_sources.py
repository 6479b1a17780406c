"""Evaluations at the end of a study that reveal errors in its estimates other than noise.

The best candidate is evaluated once more with derivatives with respect to the nuisance parameters
of its organ, and once on a mesh of another size. `results.identification` uses both for the
intervals.
"""

from palpate.service.study.evaluations import EvaluationRun
from palpate.storage.errors import PalpateError
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.tasks import EvaluationRequest, FitJson, MeshFit

# Ratio of the nodes of the other mesh to the study's own.
NODE_RATIO = 3.0
# Above this number of nodes the other mesh is coarser.
MOST_NODES = 150_000


class Lost(Exception):  # noqa: N818 - the study ends without it, and the next run tries again
    """An evaluation that was lost with its workers."""


def nuisance_fit(best: EvaluationRecord, evaluation: EvaluationRun) -> FitJson | None:
    """Return the least-squares problem of the best candidate with the nuisance parameters.

    Raises
    ------
    Lost
        If the evaluation was lost with its workers.
    """
    request = evaluation.work.nuisances_request(best.genes)
    return None if request is None else _fit(evaluation, request)


def mesh_fits(best: EvaluationRecord, evaluation: EvaluationRun) -> list[MeshFit]:
    """Return the least-squares problem of the best candidate on another mesh, if there is one.

    Raises
    ------
    Lost
        If the evaluation was lost with its workers.
    """
    nodes = evaluation.work.resolution(None).body["facts"].get("nodes")
    if nodes is None:
        return []
    ratio = NODE_RATIO if NODE_RATIO * nodes <= MOST_NODES else 1 / NODE_RATIO
    try:
        request, facts = evaluation.work.on_other_mesh(best.genes, round(ratio * nodes))
    except PalpateError:  # this body has no other mesh
        return []
    fit = _fit(evaluation, request)
    return [] if fit is None else [MeshFit(nodes=int(facts["nodes"]), fit=fit)]


def _fit(evaluation: EvaluationRun, request: EvaluationRequest) -> FitJson | None:
    work = evaluation.work
    calls = [(request["digest"], work.arguments(request))]
    (ending,) = evaluation.dispatcher.run(work.evaluate, calls)
    if ending.kind == "lost":
        raise Lost
    fit: FitJson | None = (ending.value or {}).get("fit")
    return fit

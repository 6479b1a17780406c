"""The task that computes findings about a fitted body; see `workers.organs.registry.Findings`."""

from typing import Any

from palpate.storage.plain import to_plain
from palpate.storage.records.tasks import EvaluationRequest
from palpate.storage.stores.store import open_store
from palpate.workers.organs.registry import findings_of
from palpate.workers.spec import validated
from palpate.workers.tasks.body_store import BodyStore
from palpate.workers.tasks.evaluation import case_of, case_organ, spec_of


def find(request: EvaluationRequest) -> dict[str, Any]:
    """Return the findings about a finished evaluation as plain values, if any."""
    organ, spec = case_organ(request["case"]), case_of(request["case"])
    module = findings_of(spec.organ)
    if module is None:
        return {}
    score = validated(spec_of(request["case"]).score, request.get("score") or {}, "The score")
    body, mesh = request["prepared"]["volume"], request["prepared"]["mesh"]
    bodies = BodyStore(open_store(request["store"]), organ)
    values = spec.complete(request["constants"])
    landmarks = bodies.landmarks(body, spec)
    found = module.findings(
        bodies.model(mesh),
        spec,
        values,
        landmarks,
        score,
        bodies.body(body),
        request.get("free") or (),
    )
    return dict(to_plain(found))

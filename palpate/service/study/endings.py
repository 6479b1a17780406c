"""Records of evaluation endings, and errors when the cluster or the model is to blame."""

import math
import re
from collections.abc import Mapping
from functools import partial

from palpate.service.cluster.dispatch import Ending
from palpate.service.errors import ClusterError, GenerationCrashError
from palpate.service.study.replay import PendingGeneration
from palpate.storage.records.best_candidate import minimised
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.status import Status
from palpate.storage.records.tasks import EvaluationResult

# If a generation loses more than this share of its candidates, the cluster is to blame.
MAX_LOST_SHARE = 0.2
# Differences between two messages for the same reason.
NUMBERS = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
NO_SHARED_TISSUE = "it has no score: candidate and target have no compared tissue in common"


def blame_cluster_if_many(lost: list[Ending], evaluations: int) -> None:
    """Raise an error if many evaluations are lost: the cluster is to blame, not a candidate."""
    if len(lost) > max(1, MAX_LOST_SHARE * evaluations):
        raise ClusterError(
            f"{len(lost)} of {evaluations} candidates have repeatedly lost their workers: "
            f"{lost[0].reason}. The workers may have too little memory: start fewer with "
            "--workers, then run the study again; completed work is kept."
        )


def refuse_if_all_crashed(crashed: list[Ending], generation: int) -> None:
    """Raise an error if all candidates crash for the same reason, which would recur."""
    reasons = {NUMBERS.sub("#", ending.reason) for ending in crashed}
    if len(crashed) > 1 and len(reasons) == 1:
        raise GenerationCrashError(
            f"All {len(crashed)} candidates of generation {generation + 1} have crashed for the "
            f"same reason: {crashed[0].reason}. None of them is saved: correct the cause, and "
            "run the same command again to continue the study.",
            crashed[0].traceback,
        )


def evaluation_record(
    pending: PendingGeneration, candidate: int, ending: Ending, reused: bool
) -> EvaluationRecord:
    """Return the journal record of an ending."""
    return ending_record(
        ending,
        candidate=candidate,
        generation=pending.number,
        genes=pending.genes(candidate),
        reused=reused,
        level=pending.proposal.level,
    )


def ending_record(
    ending: Ending,
    *,
    candidate: int,
    generation: int,
    genes: Mapping[str, float],
    reused: bool,
    level: int | None = None,
) -> EvaluationRecord:
    """Return the record of an ending; see `EvaluationRecord`."""
    record = partial(
        EvaluationRecord,
        candidate=candidate,
        generation=generation,
        genes=genes,
        digest=ending.key,
        attempts=max(1, ending.attempts),
        reused=reused,
        level=level,
    )
    result: EvaluationResult | None = ending.value
    if result is None:
        status = Status.CRASHED if ending.kind == "crashed" else Status.LOST
        traceback = ending.traceback if status is Status.CRASHED else ""
        return record(status=status, reason=ending.reason, traceback=traceback)
    record = partial(
        record,
        outcome=result.get("outcome"),
        seconds=result.get("seconds", {}),
        worker=result.get("worker", ""),
        fit=result.get("fit"),
    )
    score = result.get("score")
    if result["status"] == "done" and score is not None and minimised(score) < math.inf:
        return record(status=Status.DONE, score=score)
    return record(status=Status.DIVERGED, reason=result.get("reason") or NO_SHARED_TISSUE)

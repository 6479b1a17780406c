"""Diagnoses with the tasks and the store of a cluster, all in this process."""

from collections.abc import Iterable
from pathlib import Path

from palpate.service.blind.answering.single_process import InThisProcess
from palpate.service.diagnosis.run import request_for, run
from palpate.workers.diagnosis.outcome.source import Source
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis, diagnose
from palpate.workers.tasks.diagnosis import replay
from palpate.workers.tasks.diagnosis_store import DiagnosisStore


def diagnosed_store(
    source: Source,
    store: Path,
    nodes: int,
    spacing_mm: float | None = None,
    effects: Iterable[str] | None = None,
) -> DiagnosisStore:
    """Run a diagnosis to its end and return its store."""
    request = request_for(source, store, nodes, spacing_mm, effects)
    run(request, InThisProcess())
    return DiagnosisStore(request)


def diagnosis_in(store: DiagnosisStore) -> Diagnosis:
    """Return the finished diagnosis in a store."""
    reached = replay(store, diagnose(store.analysis, store.effects))
    assert isinstance(reached, Diagnosis)
    return reached

"""Diagnoses with the tasks and the store of a cluster, all in this process."""

from collections.abc import Iterable
from pathlib import Path

from palpate.service.blind.diagnosed_case import InThisProcess
from palpate.service.diagnosis.diagnosis_run import request_for, run_diagnosis
from palpate.workers.diagnosis.outcome.diagnosis_source import Source
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis, diagnose
from palpate.workers.tasks.diagnosis_store import DiagnosisStore
from palpate.workers.tasks.diagnosis_tasks import replay


def diagnosed_store(
    source: Source,
    store: Path,
    nodes: int,
    spacing_mm: float | None = None,
    effects: Iterable[str] | None = None,
) -> DiagnosisStore:
    """Run a diagnosis to its end and return its store."""
    request = request_for(source, store, nodes, spacing_mm, effects)
    run_diagnosis(request, InThisProcess())
    return DiagnosisStore(request)


def diagnosis_in(store: DiagnosisStore) -> Diagnosis:
    """Return the finished diagnosis in a store."""
    reached = replay(store, diagnose(store.analysis, store.effects))
    assert isinstance(reached, Diagnosis)
    return reached

"""The parts of a study's folder that a diagnosis needs."""

from pathlib import Path

from palpate.storage.backends.layout import StudyLayout
from palpate.storage.errors import InputError
from palpate.storage.records.best_candidate import best_of
from palpate.storage.records.journal import Journal
from palpate.storage.records.record import (
    EvaluationRecord,
    SessionRecord,
    StudyRecord,
    caveats_in,
    record_of,
)
from palpate.storage.stores.store import open_store
from palpate.workers.diagnosis.outcome.source import FinishedStudy
from palpate.workers.organs.registry import DEFAULT, organ_named
from palpate.workers.organs.source_registry import StudySource, source_of_study
from palpate.workers.tasks.body_store import BodyStore


def is_study(folder: Path) -> bool:
    """Return True if the folder contains a study made by `palpate run`."""
    return StudyLayout(folder).journal.is_file()


def open_study(folder: Path) -> StudySource:
    """Read a study that has run, as the source of a diagnosis.

    Parameters
    ----------
    folder : Path
        Folder of the study. Its store must still contain the volumes that the study was run with.

    Raises
    ------
    InputError
        If there is no study, or none of its evaluations has started.
    JournalError, StoreError
        If the journal or the store is damaged, or a volume is missing.
    """
    layout = StudyLayout(folder)
    if not is_study(folder):
        raise InputError(f"{folder} is not a study: it has no {layout.journal.name}.")
    records = [record_of(line) for line in Journal.read(layout.journal)]
    sessions = [r for r in records if isinstance(r, SessionRecord)]
    studies = [r for r in records if isinstance(r, StudyRecord)]
    evaluations = [r for r in records if isinstance(r, EvaluationRecord)]
    if not sessions or not studies:
        raise InputError(
            f"The study {folder} has not run, so it has no body yet. Run it first with "
            f"`palpate run {folder}`."
        )
    spec = studies[0].spec
    prepared, target = sessions[-1].prepared["volume"], sessions[-1].target["target"]
    organ = spec["case"].get("organ", DEFAULT)
    best = best_of({record.candidate: record for record in evaluations})
    bodies = BodyStore(open_store(sessions[-1].store), organ_named(organ))
    study = FinishedStudy(
        name=spec["name"],
        case=spec["case"],
        target=spec["target"],
        score=spec["score"],
        parameters=spec["search"]["parameters"],
        best={} if best is None else best.genes,
        reference=bodies.body(prepared),
        deformed=bodies.body(target),
        caveats=caveats_in(sessions),
    )
    return source_of_study(organ, study)

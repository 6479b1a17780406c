"""Reads all that a study's page is made from, once."""

from dataclasses import dataclass, field
from pathlib import Path

from service.report.study_bodies import Bodies, find_bodies
from service.results import StudyResults, study_results
from service.study_log import read_study
from storage.records import EvaluationRecord, SessionRecord


@dataclass(frozen=True, eq=False)
class StudyData:
    """What is known of a study.

    Parameters
    ----------
    results : StudyResults
        What it has found so far.
    endings : tuple of EvaluationRecord
        Of all candidates so far.
    session : SessionRecord or None
        The last run.
    bodies : Bodies
        Volumes that the store still has.
    """

    results: StudyResults
    endings: tuple[EvaluationRecord, ...] = ()
    session: SessionRecord | None = None
    bodies: Bodies = field(default_factory=Bodies)


def read_study_data(study_dir: Path) -> StudyData:
    """Read journal, results and volumes of a study.

    Raises
    ------
    InputError
        If there is no study in that folder.
    StoreError
        If its journal is damaged.
    """
    results = study_results(study_dir)
    _, log = read_study(study_dir)
    best = None if results.best is None else results.best.digest
    unscored = log.end is None
    bodies = find_bodies(study_dir, results.spec, log.last_session, best, compare=unscored)
    return StudyData(results, tuple(log.endings.values()), log.last_session, bodies)

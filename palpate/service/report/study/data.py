"""The data of a study's page."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from palpate.service.report.study.bodies import Bodies, find_bodies
from palpate.service.results.read import study_results
from palpate.service.results.record import StudyResults
from palpate.service.study.log import read_study
from palpate.storage.records.record import EvaluationRecord, SessionRecord


@dataclass(frozen=True, eq=False)
class StudyData:
    """The data of a study.

    Parameters
    ----------
    results : StudyResults
        Results so far.
    endings : tuple of EvaluationRecord
        Endings of all candidates so far.
    sessions : tuple of SessionRecord
        All runs.
    bodies : Bodies
        Volumes still in the store.
    quick : bool
        Whether the page is written during the search, without slow parts.
    """

    results: StudyResults
    endings: tuple[EvaluationRecord, ...] = ()
    sessions: tuple[SessionRecord, ...] = ()
    bodies: Bodies = field(default_factory=Bodies)
    quick: bool = False

    @property
    def session(self) -> SessionRecord | None:
        """Return the last run; None if preparation was never completed."""
        return self.sessions[-1] if self.sessions else None


def read_study_data(study_dir: Path, *, quick: bool = False) -> StudyData:
    """Read journal, results and volumes of a study.

    Parameters
    ----------
    study_dir : Path
    quick : bool
        Skip parts that take more than 0.1 s: surfaces in three dimensions, and scores that are
        not in the journal.

    Raises
    ------
    InputError
        If there is no study in the folder.
    StoreError
        If its journal is damaged.
    """
    results = study_results(study_dir)
    _, log = read_study(study_dir)
    best = None if results.best is None else results.best.digest
    unscored = log.end is None and not quick
    bodies = find_bodies(
        study_dir, results.spec, log.last_session, best, compare=unscored, in_3d=not quick
    )
    canonical = results.spec.case.canonical
    endings = tuple(replace(r, genes=canonical(r.genes)) for r in log.endings.values())
    return StudyData(results, endings, log.sessions, bodies, quick)

"""All that a report is made from, read once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.chronicle import End, Session, read_study
from service.report.bodies import Bodies, find_bodies
from service.results import study_results
from service.study import best_of
from storage.plain import from_plain
from storage.records import EvaluationRecord


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a study.

    Parameters
    ----------
    results : mapping
        As `service.results` tells them; numbers may be infinite.
    spec : mapping
        The study file with all defaults, as the journal holds it.
    endings : tuple of EvaluationRecord
        Of all candidates so far.
    best : EvaluationRecord or None
        The one with the lowest score.
    session : Session or None
        The last run.
    end : End or None
        If the search has stopped.
    bodies : Bodies
        Volumes that the store still has.
    """

    results: Mapping[str, Any]
    spec: Mapping[str, Any]
    endings: tuple[EvaluationRecord, ...] = ()
    best: EvaluationRecord | None = None
    session: Session | None = None
    end: End | None = None
    bodies: Bodies = field(default_factory=Bodies)


def gather(study_dir: Path) -> Evidence:
    """Read journal, results and volumes of a study.

    Raises
    ------
    InputError
        If there is no study in that folder.
    StoreError
        If its journal is damaged.
    """
    study, told = read_study(study_dir)
    best = best_of(told.endings)
    session = told.sessions[-1] if told.sessions else None
    return Evidence(
        from_plain(study_results(study_dir)),
        study.spec,
        tuple(told.endings.values()),
        best,
        session,
        told.end,
        find_bodies(study_dir, session, None if best is None else best.digest),
    )

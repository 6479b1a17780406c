"""Runs one study of the queue."""

import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from palpate.service.run_study import Entrance, run_study
from palpate.service.study.loop import Study, Tasks
from palpate.service.study.session import Session
from palpate.service.study.spec import StudySpec
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.backends.places import Location
from palpate.workers import WORKER_ENVIRONMENT
from palpate.workers.spec import validated

REPORT_S = 900.0


def study_request(spec: StudySpec, accept_new_code: bool, anyway: bool = False) -> dict[str, Any]:
    """Return what the queue keeps of a study."""
    return {
        "name": spec.name,
        "spec": spec.as_dict(),
        "accept_new_code": accept_new_code,
        "anyway": anyway,
        "most_evaluations": spec.most_evaluations,
        "most_generations": spec.most_generations,
    }


def run_job(
    request: Mapping[str, Any],
    folder: Path,
    store: Location,
    session: Session,
    tasks: Tasks | None = None,
    *,
    reports: bool = True,
) -> None:
    """Run a study of the queue to its end, or continue it.

    Parameters
    ----------
    request : mapping
        See `study_request`.
    folder : Path
    store : str or Path
    session : Session
    tasks : Tasks, optional
    reports : bool
        Write the page at the end, unless there is one.

    Raises
    ------
    PalpateError, Interrupted
        As `service.run_study.run_study`.
    """
    spec = validated(StudySpec, request["spec"], "The study")
    accept = bool(request.get("accept_new_code"))
    study = Study(spec, folder, store, tasks=tasks, accept_new_code=accept)
    page = write_report if reports else _no_page
    entrance = Entrance(anyway=bool(request.get("anyway")), on_a_worker=True, write_page=page)
    if run_study(study, nullcontext(session), entrance) is None:
        page(folder, False)


def _no_page(folder: Path, quick: bool) -> None:
    """Leave the page out."""


def write_report(folder: Path, quick: bool) -> None:
    """Write the page of a study that has ended, in a process of its own, unless there is one.

    A failure is no failure of the study. A study that is stopped has the service's live page.
    """
    if quick or StudyLayout(folder).report.exists():
        return
    subprocess.run(
        [sys.executable, "-m", "palpate", "report", str(folder)],
        env=os.environ | WORKER_ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=REPORT_S,
        check=False,
    )

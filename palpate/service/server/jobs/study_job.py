"""One queued study."""

import logging
import subprocess
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from palpate.service.cluster.dispatch import TaskRunner
from palpate.service.run_study import Entrance, run_study
from palpate.service.server.jobs.helper_process import helper_command, helper_environment
from palpate.service.study.loop import Study, Tasks
from palpate.service.study.session import Session
from palpate.service.study.spec import StudySpec
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.backends.places import Location
from palpate.workers.spec import validated

_log = logging.getLogger(__name__)

REPORT_S = 900.0


class ReportError(Exception):
    """An error in writing the page of a study; the study itself is complete."""


def study_request(spec: StudySpec, accept_new_code: bool, anyway: bool = False) -> dict[str, Any]:
    """Return the request of a study for the queue."""
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
    session: Session[TaskRunner],
    tasks: Tasks | None = None,
    *,
    reports: bool = True,
) -> None:
    """Run or continue a queued study.

    Parameters
    ----------
    request : mapping
        See `study_request`.
    folder : Path
    store : str or Path
    session : Session
    tasks : Tasks, optional
    reports : bool
        Write the page at the end, unless it exists.

    Raises
    ------
    PalpateError, Interrupted
        As in `service.run_study.run_study`.
    ReportError
        If the study has ended but its page could not be written.
    """
    spec = validated(StudySpec, request["spec"], "The study")
    accept = bool(request.get("accept_new_code"))
    study = Study(spec, folder, store, tasks=tasks, accept_new_code=accept)
    page = write_report if reports else _no_page
    entrance = Entrance(anyway=bool(request.get("anyway")), on_a_worker=True, write_page=page)
    if run_study(study, nullcontext(session), entrance) is None:
        page(folder, False)


def _no_page(folder: Path, quick: bool) -> None:
    """Skip the page."""


def write_report(folder: Path, quick: bool) -> None:
    """Write the page of a completed study in a separate process, unless it exists.

    A stopped study has the service's live page.

    Raises
    ------
    ReportError
        If it fails, which does not affect the study.
    """
    if quick or StudyLayout(folder).report.exists():
        return
    try:
        ended = subprocess.run(
            helper_command("palpate", "report", str(folder)),
            env=helper_environment(),
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=REPORT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ReportError(f"it was not finished after {REPORT_S:.0f} s") from None
    if ended.returncode != 0:
        lines = ended.stderr.decode(errors="replace").strip().splitlines()
        _log.error("The page of %s could not be written: %s", folder, "\n".join(lines))
        raise ReportError(
            lines[-1] if lines else f"its process ended with exit code {ended.returncode}"
        )

"""Runs one study of the queue."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.dask_records import DaskRecords
from service.dispatch import Dispatcher
from service.preflight import preflight
from service.spec import StudySpec
from service.study import Study, Tasks
from storage.places import Location, place_of
from workers import WORKER_ENVIRONMENT
from workers.organs.study_checks import Finding, caveats_of
from workers.spec import validated

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


def run_study(
    request: Mapping[str, Any],
    folder: Path,
    store: Location,
    dispatcher: Dispatcher,
    dashboard: str,
    tasks: Tasks | None = None,
) -> None:
    """Run a study to its end, from wherever it stands.

    Raises
    ------
    PalpateError, Interrupted
        As `Study.run`.
    """
    spec = validated(StudySpec, request["spec"], "The study")
    accept, anyway = bool(request.get("accept_new_code")), bool(request.get("anyway"))
    study = Study(spec, folder, store, tasks=tasks, accept_new_code=accept)
    if not study.ended:
        if not study.begun:
            findings = dispatcher.call(check_study, spec.as_dict(), str(study.store), anyway)
            study.caveats = caveats_of(findings)
        study.hooks.add(DaskRecords(dispatcher.client))
        study.run(dispatcher, dashboard)


def check_study(spec: Mapping[str, Any], store: str, anyway: bool) -> list[Finding]:
    """Check a study; a task, so that a damaged image harms a worker only.

    Raises
    ------
    InputError
        If it is refused, with every reason.
    """
    return preflight(validated(StudySpec, spec, "The study"), place_of(store), anyway=anyway)


def write_report(folder: Path) -> None:
    """Write the page of a study, in a process of its own; a failure is no failure of the study."""
    subprocess.run(
        [sys.executable, "-m", "service", "report", str(folder)],
        env=os.environ | WORKER_ENVIRONMENT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=REPORT_S,
        check=False,
    )

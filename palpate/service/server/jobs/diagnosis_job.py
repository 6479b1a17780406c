"""One queued diagnosis; its steps are journalled like the endings of a study."""

import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.diagnosis.dask_observer import run_and_tell
from palpate.service.diagnosis.run import finished, request_for, with_caveats
from palpate.service.diagnosis.step import Step
from palpate.service.report.diagnosis.files import write_diagnosis
from palpate.service.report.diagnosis.made import Origin, origin_of
from palpate.storage.backends.atomic import explained
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.backends.places import Location
from palpate.storage.errors import InputError
from palpate.storage.records.journal import Journal
from palpate.storage.records.record import SCHEMA_VERSION
from palpate.workers.input_files import confined_to
from palpate.workers.mechanics.parameters import unknown_name
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest
from palpate.workers.tasks.sources import check_source, open_source, source_caveats


def bring_source(
    path: str,
    store: str,
    nodes: int,
    effects: tuple[str, ...] | None,
    when: str,
    anyway: bool = False,
    within: str | None = None,
) -> tuple[DiagnosisRequest, Origin, tuple[str, ...]]:
    """Read the source into the store, in a task, so a damaged image affects only a worker.

    An upload may only name files in its folder `within`.

    Raises
    ------
    InputError
        If the source cannot be diagnosed, or an effect is not in its catalogue.
    """
    with nullcontext() if within is None else confined_to(Path(within)):
        opened = open_source(Path(path), store)
    known = [effect.name for effect in opened.effects]
    for name in effects or ():
        if name not in known:
            raise InputError(unknown_name("effect", name, known))
    caveats = source_caveats(opened, check_source(opened, anyway=anyway))
    request = request_for(opened, store, nodes, effects=effects)
    return request, origin_of(opened, request, when, "", None), caveats


def run_diagnosis(
    request: Mapping[str, Any], source: Path, folder: Path, store: Location, dispatcher: Dispatcher
) -> None:
    """Run or resume a diagnosis; write its page and record to `folder`.

    Raises
    ------
    PalpateError, Interrupted
        As in `service.diagnosis.run.run`.
    """
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    effects = request.get("effects")
    named = None if effects is None else tuple(dict.fromkeys(effects))
    began, when = time.monotonic(), datetime.now(UTC).isoformat(timespec="seconds")
    with Journal(StudyLayout(folder).journal) as journal:

        def append(kind: str, **values: Any) -> None:
            journal.append({"kind": kind, "schema_version": SCHEMA_VERSION} | values)

        def observe(step: Step) -> None:
            append("step", phase=step.phase, done=step.done, of=step.of, task=step.task)

        append("session", began=when)
        anyway = bool(request.get("anyway"))
        within = str(source if source.is_dir() else source.parent)
        asked, origin, caveats = dispatcher.call(
            bring_source,
            str(source),
            str(store),
            request["nodes"],
            named,
            when,
            anyway,
            within if request["source"].get("upload") else None,
        )
        stored = finished(asked) is not None
        diagnosis = with_caveats(run_and_tell(asked, dispatcher, folder, observe), caveats)
        spent = None if stored else time.monotonic() - began
        write_diagnosis(
            diagnosis, folder, replace(origin, made=replace(origin.made, seconds=spent))
        )
        append("end", reason="all computed", verdict=diagnosis.summary.verdict)

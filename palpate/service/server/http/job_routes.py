"""Job routes of the API: submit, list, view, follow, pause, resume, cancel, files."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import FileResponse, StreamingResponse

from palpate.service.results.results_as_json import candidate_json, study_json
from palpate.service.results.results_from_journal import candidate_results, study_results
from palpate.service.server.api_models import (
    DiagnosisSubmission,
    JobPage,
    JobView,
    JournalPage,
    PriorityChange,
    Problem,
    State,
    StudySubmission,
    public_text,
)
from palpate.service.server.http.event_streams import event_stream, job_events
from palpate.service.server.http.request_checks import (
    Here,
    StrictRoute,
    Writer,
    check_may_change,
    reader,
)
from palpate.service.server.http.service_views import ENDED, job_file, job_view, state_of, view_now
from palpate.service.server.job_progress import JournalTail
from palpate.service.server.jobs.home_and_tokens import NAME_PATTERN
from palpate.service.server.jobs.job_queue import Job
from palpate.service.server.jobs.study_and_diagnosis_jobs import study_request
from palpate.service.server.jobs.untrusted_inputs import study_from
from palpate.service.server.running_service import Service
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError

# A report page runs in a sandbox, without the session cookie.
SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; img-src data: blob:; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; font-src data:"
)
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".jsonl": "application/x-ndjson",
    ".yaml": "text/plain; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
}

Identifier = Annotated[str, PathParameter(alias="job", pattern=NAME_PATTERN)]
Offset = Annotated[int, Query(ge=0, lt=2**53)]


def _refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    return {code: {"model": Problem} for code in codes}


def known_job(service: Here, identifier: Identifier) -> Job:
    """Return the job named by a path.

    Raises
    ------
    HTTPException
        404 if it does not exist.
    """
    job = service.queue.get(identifier)
    if job is None:
        raise HTTPException(404, f"There is no job {identifier}. GET /api/v1/jobs lists all.")
    return job


Known = Annotated[Job, Depends(known_job)]


def followed_journal(
    service: Here,
    job: Known,
    since: Offset = 0,
    last_event_id: Annotated[str | None, Header(pattern=r"^[0-9]{1,15}$")] = None,
) -> JournalTail:
    """Return the journal of a job from a browser's last event, or from `since`."""
    offset = since if last_event_id is None else int(last_event_id)
    return JournalTail(StudyLayout(service.home.job(job.id)).journal, offset)


Followed = Annotated[JournalTail, Depends(followed_journal)]

router = APIRouter(
    route_class=StrictRoute,
    tags=["jobs"],
    dependencies=[Depends(reader)],
    responses=_refusals(400, 401, 403, 421, 422),
)


@router.post("/studies", status_code=201, responses=_refusals(409, 413))
def submit_study(service: Here, owner: Writer, given: StudySubmission, answer: Response) -> JobView:
    """Queue a study. Status 201, or 200 with the job submitted earlier with the same key."""
    _check_room(service)
    spec = study_from(given.study, service.uploads, service.store, service.limits)
    job, new = service.queue.submit(
        "study",
        spec.name,
        owner.name,
        study_request(spec, given.accept_new_code, given.anyway),
        priority=given.priority,
        key=given.key,
        taken=lambda identifier: service.home.job(identifier).exists(),
    )
    answer.status_code = 201 if new else 200
    return job_view(service, job)


@router.post("/diagnoses", status_code=201, responses=_refusals(404, 409, 413))
def submit_diagnosis(
    service: Here, owner: Writer, given: DiagnosisSubmission, answer: Response
) -> JobView:
    """Queue the diagnosis of an upload, or of a study of this service that has run."""
    _check_room(service)
    source = given.source
    if source.study is not None:
        studied = service.queue.get(source.study)
        if studied is None or studied.kind != "study":
            raise HTTPException(404, f"There is no study {source.study}.")
        name = f"{source.study}-diagnosis"[:96]
    else:
        if service.uploads.resolve(str(source.upload)) is None:
            raise HTTPException(404, f"There is no upload {source.upload}. Upload it first.")
        name = str(source.upload).partition("/")[0]
    request = given.model_dump(mode="json", include={"source", "nodes", "effects", "anyway"})
    job, new = service.queue.submit(
        "diagnosis",
        name,
        owner.name,
        request | {"name": name},
        priority=given.priority,
        key=given.key,
        taken=lambda identifier: service.home.job(identifier).exists(),
    )
    answer.status_code = 201 if new else 200
    return job_view(service, job)


@router.get("/jobs")
def list_jobs(
    service: Here,
    kind: Literal["study", "diagnosis"] | None = None,
    state: State | None = None,
    before: Annotated[int | None, Query(ge=0, lt=2**53)] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> JobPage:
    """List jobs in pages, newest first."""
    chosen = [
        job
        for job in reversed(service.queue.jobs)
        if (kind is None or job.kind == kind)
        and (state is None or state_of(service, job) == state)
        and (before is None or job.number < before)
    ]
    shown = chosen[:limit]
    more = shown[-1].number if len(chosen) > limit else None
    return JobPage(jobs=[job_view(service, job) for job in shown], more=more)


@router.get("/jobs/{job}", responses=_refusals(404))
def get_job(service: Here, job: Known) -> JobView:
    """Return a job and its progress."""
    return job_view(service, job)


@router.post("/jobs/{job}/{action}", responses=_refusals(404, 409))
def change_job(
    service: Here, owner: Writer, job: Known, action: Literal["pause", "resume", "cancel"]
) -> JobView:
    """Pause a job, resume a paused or failed one, or cancel it permanently.

    Allowed for the token that submitted it and for admins.
    """
    check_may_change(owner, job)
    return job_view(service, service.queue.change(job.id, action))


@router.patch("/jobs/{job}", responses=_refusals(404))
def change_priority(service: Here, owner: Writer, job: Known, given: PriorityChange) -> JobView:
    """Change the priority of a job, effective the next time the job runs."""
    check_may_change(owner, job)
    return job_view(service, service.queue.prioritise(job.id, given.priority))


@router.get("/jobs/{job}/results", responses=_refusals(404, 409))
def get_results(service: Here, job: Known) -> dict[str, Any]:
    """Return the results of a study (see `palpate report --json`), or a diagnosis record."""
    if job.kind == "study":
        return study_json(study_results(_begun(service, job)))
    path = job_file(service, job, "diagnosis.json")
    if path is None:
        raise HTTPException(409, f"{job.id} is {state_of(service, job)} and has no result yet.")
    record: dict[str, Any] = json.loads(path.read_bytes())
    return record


@router.get("/jobs/{job}/candidates/{candidate}", responses=_refusals(404, 409))
def get_candidate(
    service: Here, job: Known, candidate: Annotated[int, PathParameter(ge=0, lt=2**53)]
) -> dict[str, Any]:
    """Return the full record of one candidate of a study; see `palpate show --json`."""
    if job.kind != "study":
        raise HTTPException(409, f"{job.id} is a diagnosis; only studies have candidates.")
    try:
        return candidate_json(candidate_results(_begun(service, job), candidate))
    except InputError as error:
        raise HTTPException(404, public_text(str(error))) from error


@router.get("/jobs/{job}/journal", responses=_refusals(404, 409))
def get_journal(service: Here, job: Known, since: Offset = 0) -> JournalPage:
    """Return a page of records of a job's journal, starting at an offset."""
    tail = JournalTail(StudyLayout(service.home.job(job.id)).journal, since)
    lines = tail.read()
    return JournalPage(
        records=[line.record for line in lines],
        since=tail.offset,
        complete=not lines and job.state in ENDED,
    )


@router.get(
    "/jobs/{job}/events",
    response_class=StreamingResponse,
    responses=_refusals(404, 503) | {200: {"content": {"text/event-stream": {}}}},
)
async def follow_job(
    service: Here, request: Request, job: Known, tail: Followed
) -> StreamingResponse:
    """Follow a job with server-sent events: `job`, `record`, and finally `end`."""
    return event_stream(
        request, service, lambda gone: job_events(tail, lambda: view_now(service, job), gone)
    )


@router.get(
    "/jobs/{job}/files/{name}",
    response_class=FileResponse,
    responses=_refusals(404) | {200: {"content": {"*/*": {}}}},
)
def get_file(
    service: Here, job: Known, name: Annotated[str, PathParameter(pattern=NAME_PATTERN)]
) -> Response:
    """Return one of a job's ``files``."""
    path = job_file(service, job, name)
    if path is None:
        raise HTTPException(404, f"{job.id} has no file {name}.")
    size = path.stat().st_size
    headers = {"Content-Security-Policy": SANDBOX, "Content-Length": str(size)}
    media_type = TYPES[path.suffix]
    return StreamingResponse(_first_bytes(path, size), media_type=media_type, headers=headers)


def _first_bytes(path: Path, size: int) -> Iterator[bytes]:
    """Yield the first `size` bytes of a file; a journal may be growing."""
    with path.open("rb") as file:
        while size > 0 and (block := file.read(min(size, 2**16))):
            size -= len(block)
            yield block


def _begun(service: Service, job: Job) -> Path:
    folder = service.home.job(job.id)
    journal = StudyLayout(folder).journal
    if not journal.is_file() or os.path.getsize(journal) == 0:  # noqa: PTH202
        raise HTTPException(409, f"{job.id} has not started yet.")
    return folder


def _check_room(service: Service) -> None:
    open_jobs = sum(job.state not in ENDED for job in service.queue.jobs)
    if open_jobs >= service.limits.waiting_jobs:
        raise HTTPException(409, f"{open_jobs} jobs are waiting already: wait, or cancel some.")

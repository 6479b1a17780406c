"""Routes of the web page: its files, and what it watches: all jobs, compact studies, bodies.

The page is one HTML file, its style sheet and its scripts. There is no build step, and nothing is
loaded from other sites. The slice and body viewers are shared with the reports.
"""

from pathlib import Path
from typing import Any

from fastapi import APIRouter, Depends, HTTPException, Request, Response
from fastapi.responses import FileResponse, StreamingResponse

from palpate.service.server.api_models import BodiesView, JobView, Problem, StudyView
from palpate.service.server.http.event_streams import all_job_events, event_stream, job_events
from palpate.service.server.http.job_routes import Followed, Known
from palpate.service.server.http.request_checks import Here, StrictRoute, reader
from palpate.service.server.http.service_views import ENDED, job_view, study_view, view_now
from palpate.service.server.jobs.job_queue import Job
from palpate.service.server.running_service import Service

PAGE_FOLDER = Path(__file__).parents[1] / "page"
REPORT_FOLDER = Path(__file__).parents[2] / "report" / "page"
PAGE_TYPES = {".css": "text/css", ".js": "text/javascript"}
PAGE_FILES = {
    path.name: path
    for path in (
        *sorted(PAGE_FOLDER.glob("*.css")),
        *sorted(PAGE_FOLDER.glob("*.js")),
        REPORT_FOLDER / "report.css",
        *(REPORT_FOLDER / "scripts" / name for name in ("common.js", "slices.js", "body.js")),
    )
}

page_router = APIRouter(include_in_schema=False)


@page_router.get("/")
def get_page() -> Response:
    """Return the page, which gets its data from the API."""
    return FileResponse(PAGE_FOLDER / "index.html", media_type="text/html; charset=utf-8")


@page_router.get("/page/{name}")
def get_part(name: str) -> Response:
    """Return the style sheet or a script."""
    path = PAGE_FILES.get(name)
    if path is None:
        raise HTTPException(404, f"The page has no file {name[:80]!r}.")
    return FileResponse(path, media_type=f"{PAGE_TYPES[path.suffix]}; charset=utf-8")


NEWEST = 100
EVENT_STREAM: dict[int | str, dict[str, Any]] = {200: {"content": {"text/event-stream": {}}}}


def _refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    return {code: {"model": Problem} for code in codes}


watch_router = APIRouter(
    route_class=StrictRoute,
    tags=["watching"],
    dependencies=[Depends(reader)],
    responses=_refusals(400, 401, 403, 421, 422),
)


@watch_router.get(
    "/events", response_class=StreamingResponse, responses=_refusals(503) | EVENT_STREAM
)
async def follow_all(service: Here, request: Request) -> StreamingResponse:
    """Follow all jobs with server-sent `job` events, first the newest and all running ones."""
    return event_stream(request, service, lambda gone: all_job_events(JobNews(service).next, gone))


@watch_router.get(
    "/jobs/{job}/points",
    response_class=StreamingResponse,
    responses=_refusals(404, 503) | EVENT_STREAM,
)
async def follow_points(
    service: Here, request: Request, job: Known, tail: Followed
) -> StreamingResponse:
    """Follow a job with compact server-sent events: `job`, `points`, and finally `end`."""
    return event_stream(
        request,
        service,
        lambda gone: job_events(tail, lambda: view_now(service, job), gone, brief=True),
    )


@watch_router.get("/jobs/{job}/study", responses=_refusals(404, 409))
def get_study(service: Here, job: Known) -> StudyView:
    """Return the parameters of a study and its file."""
    _check_study(job)
    return study_view(job)


@watch_router.get(
    "/jobs/{job}/bodies",
    response_model=BodiesView,
    responses=_refusals(404, 409) | {202: {"model": BodiesView}},
)
def get_bodies(service: Here, job: Known, answer: Response) -> Any:
    """Return reference, target and best candidate; 202 while they are being prepared."""
    _check_study(job)
    folder = service.home.job(job.id)
    progress = service.progress.of(folder)
    if not progress.sessions:
        raise HTTPException(409, f"{job.id} has no body yet; it is being prepared.")
    candidate = None if progress.best is None else progress.best.candidate
    path = service.bodies.of(folder, candidate)
    if path is None:
        answer.status_code = 202
        return BodiesView(ready=False)
    return FileResponse(path, media_type="application/json")


class JobNews:
    """Jobs that are new or have changed since the last call.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service
        self._told: dict[str, JobView] = {}
        self._first = max(0, len(service.queue.jobs) - NEWEST)

    def next(self) -> list[JobView]:
        """Return the changed jobs; on the first call, the newest and all unfinished ones."""
        news = []
        for job in self._service.queue.jobs:
            if not self._may_have_changed(job, self._told.get(job.id)):
                continue
            view = job_view(self._service, job)
            if view != self._told.get(job.id):
                self._told[job.id] = view
                news.append(view)
        return news

    def _may_have_changed(self, job: Job, before: JobView | None) -> bool:
        if job.state not in ENDED:
            return True
        if before is None:
            return job.number >= self._first
        return (before.state, before.changed) != (job.state, job.changed)


def _check_study(job: Job) -> None:
    if job.kind != "study":
        raise HTTPException(409, f"{job.id} is a diagnosis, not a study.")

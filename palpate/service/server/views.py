"""Views of a job in the API."""

from pathlib import Path

from palpate.service.server.api import Best, Evaluations, JobView, Phase, State
from palpate.service.server.jobs.home import inside
from palpate.service.server.jobs.queue import Job
from palpate.service.server.live.job_progress import JobProgress
from palpate.service.server.public_text import public
from palpate.service.server.service import Service
from palpate.service.study.count import left_s
from palpate.storage.errors import PalpateError, StoreError
from palpate.storage.plain import to_plain
from palpate.workers.comparison.similarity.objective import objective_named
from palpate.workers.spec import DEFAULT_OBJECTIVE

ENDED = ("finished", "failed", "cancelled")
FILES = {
    "study": ("study.yaml", "journal.jsonl", "report.html", "crash.txt"),
    "diagnosis": ("journal.jsonl", "diagnosis.json", "diagnosis.html", "crash.txt"),
}


def job_view(service: Service, job: Job) -> JobView:
    """Return a job with its progress; an unreadable journal is reported as its reason."""
    view = JobView(
        id=job.id,
        kind=job.kind,
        name=str(job.request.get("name", job.id)),
        owner=job.owner,
        priority=job.priority,
        state=state_of(service, job),
        reason=public(job.reason),
        note=public(service.runner.note(job.id)) if job.state == "waiting" else "",
        submitted=job.submitted,
        changed=job.changed,
    )
    folder = service.home.job(job.id)
    try:
        progress = service.progress.of(folder)
    except PalpateError as error:
        return view.model_copy(update={"reason": public(str(error))})
    view.sessions, view.journal_bytes = progress.sessions, progress.bytes_read
    view.stopped = progress.stopped
    view.files = [name for name in FILES[job.kind] if _is_offered(service, job, name)]
    if job.kind == "study":
        at_most = job.request.get("most_evaluations", 0)  # not in the queues of older versions
        view.evaluations = Evaluations(**progress.endings, at_most=at_most)
        view.generations = progress.generations
        view.generations_at_most = job.request.get("most_generations")
        view.per_minute = progress.per_minute
        if view.per_minute is not None:
            view.left_s = left_s(progress.endings, at_most, view.per_minute)
        view.best = _best(job, progress)
    elif progress.phase is not None:
        view.phase = Phase.model_validate(progress.phase)
    return view


def _best(job: Job, progress: JobProgress) -> Best | None:
    best = progress.best
    if best is None:
        return None
    asked = job.request["spec"].get("score") or {}
    objective = objective_named(asked.get("objective", DEFAULT_OBJECTIVE))
    score = to_plain(best.score or {})
    return Best(
        candidate=best.candidate,
        genes=dict(best.genes),
        score=score,
        objective=objective.label,
        value=score.get(objective.name),
        note=progress.ranked.note,
    )


def view_now(service: Service, job: Job) -> JobView:
    """Return the current view of a job."""
    return job_view(service, service.queue.get(job.id) or job)


def state_of(service: Service, job: Job) -> State:
    """Return the state of a job; a waiting job may be running."""
    if job.state == "waiting" and service.runner.is_running(job.id):
        return "running"
    return job.state


def _is_offered(service: Service, job: Job, name: str) -> bool:
    """Check whether a file exists; a link that points elsewhere counts as missing."""
    try:
        return job_file(service, job, name) is not None
    except StoreError:
        return False


def job_file(service: Service, job: Job, name: str) -> Path | None:
    """Return the path of a file of a job; None if it does not exist."""
    if name not in FILES[job.kind]:
        return None
    path = service.home.job(job.id) / name
    return inside(service.home.root, path) if path.is_file() else None

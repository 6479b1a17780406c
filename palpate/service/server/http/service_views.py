"""What the API shows: the view of a job, of a study, and the metrics of the service.

The view of a study comes from its file alone. The metrics are in the text format of Prometheus.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from palpate.service.number_formatting import label
from palpate.service.results.results_from_journal import estimates_of
from palpate.service.server.api_models import (
    Best,
    Evaluations,
    JobView,
    Phase,
    SearchedParameterView,
    State,
    StudyView,
    public_text,
)
from palpate.service.server.job_progress import JobProgress
from palpate.service.server.jobs.home_and_tokens import inside
from palpate.service.server.jobs.job_queue import Job
from palpate.service.server.running_service import Service
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_progress import left_s
from palpate.storage.errors import PalpateError, StoreError
from palpate.storage.json_digests import to_plain
from palpate.workers.common_keys import DEFAULT_OBJECTIVE, validated
from palpate.workers.comparison.score_objective import objective_named
from palpate.workers.input_files import dump_yaml

ENDED = ("finished", "failed", "cancelled")
JOB_FILES = {
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
        reason=public_text(job.reason),
        note=public_text(service.runner.note(job.id)) if job.state == "waiting" else "",
        submitted=job.submitted,
        changed=job.changed,
    )
    folder = service.home.job(job.id)
    try:
        progress = service.progress.of(folder)
    except PalpateError as error:
        return view.model_copy(update={"reason": public_text(str(error))})
    return view.model_copy(update=_progress_fields(service, job, progress))


def _progress_fields(service: Service, job: Job, progress: JobProgress) -> dict[str, Any]:
    """Return the fields of a view that its journal tells."""
    fields: dict[str, Any] = {
        "sessions": progress.sessions,
        "journal_bytes": progress.bytes_read,
        "stopped": progress.stopped,
        "files": [name for name in JOB_FILES[job.kind] if _is_offered(service, job, name)],
    }
    if job.kind == "study":
        at_most = job.request.get("most_evaluations", 0)  # not in the queues of older versions
        speed = progress.per_minute
        return fields | {
            "evaluations": Evaluations(**progress.endings, at_most=at_most),
            "generations": progress.generations,
            "generations_at_most": job.request.get("most_generations"),
            "per_minute": speed,
            "left_s": None if speed is None else left_s(progress.endings, at_most, speed),
            "best": _best_candidate(job, progress),
        }
    if progress.phase is not None:
        fields["phase"] = Phase.model_validate(progress.phase)
    return fields


def _best_candidate(job: Job, progress: JobProgress) -> Best | None:
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
    if name not in JOB_FILES[job.kind]:
        return None
    path = service.home.job(job.id) / name
    return inside(service.home.root, path) if path.is_file() else None


def study_view(job: Job) -> StudyView:
    """Return the parameters of a queued study, and its file."""
    spec = validated(StudySpec, job.request["spec"], "The study")
    return StudyView(
        parameters=[
            SearchedParameterView(
                gene=estimate.gene,
                label=label(name, estimate.unit),
                unit=estimate.unit,
                lower=estimate.lower,
                upper=estimate.upper,
                target=estimate.target,
            )
            for name, estimate in estimates_of(spec, None, None).items()
        ],
        score=spec.objective.axis,
        file=dump_yaml(spec.as_dict()),
    )


ENDINGS = ("done", "diverged", "crashed", "lost")


def metrics(service: Service) -> str:
    """Return jobs by state, evaluations by ending, seconds by stage, and the cluster."""
    jobs: Counter[tuple[str, str]] = Counter()
    evaluations: Counter[str] = Counter(dict.fromkeys(ENDINGS, 0))
    stages: Counter[str] = Counter()
    for job in service.queue.jobs:
        jobs[job.kind, state_of(service, job)] += 1
        try:
            progress = service.progress.of(service.home.job(job.id))
        except PalpateError:
            continue
        evaluations.update({e: progress.endings[e] for e in ENDINGS})
        stages.update(progress.stage_seconds)
    by_kind = [({"kind": k, "state": s}, n) for (k, s), n in sorted(jobs.items())]
    ended = [({"ending": e}, evaluations[e]) for e in ENDINGS]
    spent = [({"stage": s}, seconds) for s, seconds in sorted(stages.items())]
    threads, held = service.runner.threads, service.runner.share.held
    return "".join(
        (
            _metric("palpate_jobs", "gauge", "Jobs by kind and state.", by_kind),
            _metric("palpate_evaluations_total", "counter", "Evaluations by ending.", ended),
            _metric("palpate_stage_seconds_total", "counter", "Seconds in each stage.", spent),
            _metric("palpate_threads", "gauge", "Tasks that can run at once.", [({}, threads)]),
            _metric("palpate_tasks", "gauge", "Tasks running or queued.", [({}, held)]),
        )
    )


def _metric(
    name: str, kind: str, about: str, samples: Iterable[tuple[Mapping[str, str], float]]
) -> str:
    lines = [f"# HELP {name} {about}", f"# TYPE {name} {kind}"]
    for labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        lines.append(f"{name}{{{inside}}} {value:g}" if inside else f"{name} {value:g}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")

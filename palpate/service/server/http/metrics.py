"""Metrics of a service in the text format of Prometheus."""

from collections import Counter
from collections.abc import Iterable, Mapping

from palpate.service.server.service import Service
from palpate.service.server.views import state_of
from palpate.storage.errors import PalpateError

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

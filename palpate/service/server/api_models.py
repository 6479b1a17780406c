"""Request and response models of the HTTP API, and messages without server paths and tracebacks.

JSON has no infinity, so infinite scores are the strings "-inf" and "inf".
"""

import re
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from palpate.service.server.jobs.home_and_tokens import NAME_PATTERN
from palpate.workers.common_keys import FrozenModel

_TRACEBACK = re.compile(r"\s*Traceback \(most recent call last\):.*", re.DOTALL)
_PATH = re.compile(r"(?<![\w:/.])/(?:[^\s:'\",;()\[\]<>]+/)*([^\s:'\",;()\[\]<>/]*)")
MOST_CHARACTERS = 2000


def public_text(text: str) -> str:
    r"""Return a message without tracebacks and with absolute paths cut to their last name.

    Examples
    --------
    >>> public_text("/srv/palpate/runs/.service/uploads/a/scan.nrrd is cut short.")
    'scan.nrrd is cut short.'
    >>> public_text("A task crashed: ValueError\nTraceback (most recent call last):\n  File ...")
    'A task crashed: ValueError'
    >>> public_text("GET /api/v1/jobs lists all; see http://localhost:8780/x.")
    'GET /api/v1/jobs lists all; see http://localhost:8780/x.'
    """
    shown = _PATH.sub(_last_name, _TRACEBACK.sub("", text))
    return shown if len(shown) <= MOST_CHARACTERS else f"{shown[:MOST_CHARACTERS]} ..."


def _last_name(match: re.Match[str]) -> str:
    return match[0] if match[0].startswith("/api/") or len(match[0]) < 2 else match[1] or "/"


PREFIX = "/api/v1"

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Priority = Annotated[int, Field(ge=-100, le=100)]
Key = Annotated[str, Field(max_length=128, pattern=r"^[ -~]*$")]
State = Literal["waiting", "running", "paused", "finished", "failed", "cancelled"]


class Accepted(BaseModel):
    """A request body; an unknown key is an error."""

    model_config = ConfigDict(extra="forbid")


class StudySubmission(Accepted):
    """A study to run.

    ``study`` is the text of a study file or its keys; images are uploads, named FOLDER/FILE,
    or volumes in the store. ``key``: any text; submitting the same key again returns the same
    job. ``anyway``: run even if a plausibility check fails.
    """

    study: str | dict[str, Any]
    priority: Priority = 0
    key: Key = ""
    accept_new_code: bool = False
    anyway: bool = False


class DiagnosisSource(Accepted):
    """The source of a diagnosis: an upload (FOLDER or FOLDER/FILE), or a study of this service."""

    upload: Annotated[str, Field(max_length=200)] | None = None
    study: Name | None = None

    @model_validator(mode="after")
    def _one(self) -> "DiagnosisSource":
        if (self.upload is None) == (self.study is None):
            raise ValueError("give exactly one of upload and study")
        return self


class DiagnosisSubmission(Accepted):
    """A case, a study or an experiment to diagnose; ``effects``: the suspected ones, or all.

    ``anyway``: diagnose even if a plausibility check fails.
    """

    source: DiagnosisSource
    nodes: Annotated[int, Field(ge=200, le=500_000)] = 5000
    effects: Annotated[list[Name], Field(min_length=1, max_length=100)] | None = None
    anyway: bool = False
    priority: Priority = 0
    key: Key = ""


class PriorityChange(Accepted):
    """A new priority of a job."""

    priority: Priority


class SignIn(Accepted):
    """A token, exchanged for a cookie that is sent to this site only."""

    token: Annotated[str, Field(min_length=1, max_length=512)]


class Problem(BaseModel):
    """The reason for refusing a request, and what to do."""

    error: str


class Evaluations(FrozenModel):
    """Number of evaluations of a study by status."""

    done: int = 0
    diverged: int = 0
    crashed: int = 0
    lost: int = 0
    reused: int = 0
    at_most: int = 0


class Best(FrozenModel):
    """The best candidate so far; genes in the units of the study file.

    ``objective`` is the label of the score that the search optimises, ``value`` its value.
    ``note`` explains why its GSF is not the lowest, if so.
    """

    candidate: int
    genes: dict[str, float]
    score: dict[str, float | str | None]
    objective: str = "GSF"
    value: float | str | None = None
    note: str = ""


class Phase(FrozenModel):
    """The current step of a diagnosis: completed tasks, and all tasks."""

    phase: str
    done: int
    of: int
    task: str = ""


class JobView(FrozenModel):
    """A study or a diagnosis, and its progress.

    ``reason`` explains a failure, ``note`` why a waiting job is not running. ``journal_bytes``
    is the offset of its next event; see /events.
    """

    id: str
    kind: Literal["study", "diagnosis"]
    name: str
    owner: str
    priority: int
    state: State
    reason: str = ""
    note: str = ""
    submitted: str
    changed: str
    sessions: int = 0
    journal_bytes: int = 0
    evaluations: Evaluations | None = None
    generations: int | None = None
    generations_at_most: int | None = None
    per_minute: float | None = None
    left_s: float | None = None
    best: Best | None = None
    stopped: str = ""
    phase: Phase | None = None
    files: list[str] = Field(default=[])


class JobPage(BaseModel):
    """A page of jobs, newest first; ``more`` is the ``before`` of the next page."""

    jobs: list[JobView]
    more: int | None = None


class JournalPage(BaseModel):
    """Records of a journal, and the ``since`` of the next request."""

    records: list[dict[str, Any]]
    since: int
    complete: bool


class UploadView(BaseModel):
    """One uploaded file."""

    folder: str
    file: str
    size_bytes: int
    sha256: str = ""


class UploadList(BaseModel):
    """All uploads."""

    uploads: list[UploadView]


class WorkerView(FrozenModel):
    """One worker: running and waiting tasks, CPU load, memory and its limit (0: no limit)."""

    name: str
    address: str
    threads: int
    running: int
    waiting: int
    cpu_percent: float
    memory_bytes: int
    memory_limit_bytes: int


class ClusterView(FrozenModel):
    """The cluster: tasks it can run at once, tasks running or queued, Dask's dashboard."""

    ready: bool
    trouble: str = ""
    threads: int = 0
    tasks: int = 0
    dashboard: str = ""
    workers: list[WorkerView] = Field(default=[])


class SearchedParameterView(BaseModel):
    """A searched parameter in the unit of the study file; ``target`` if it is known."""

    gene: str
    label: str
    unit: str
    lower: float
    upper: float
    target: float | None = None


class StudyView(BaseModel):
    """The parameters of a study, and its file with all defaults.

    ``score``: the label of the minimised score, for an axis.
    """

    parameters: list[SearchedParameterView]
    score: str
    file: str


class BodiesView(BaseModel):
    """The data of the slice and body viewers, or the state of their preparation.

    ``tissues`` and ``differences``: (colour, meaning) of a legend.
    """

    ready: bool
    candidate: int | None = None
    slices: dict[str, Any] | None = None
    body: dict[str, Any] | None = None
    missing: list[str] = []
    tissues: list[tuple[str, str]] = []
    differences: list[tuple[str, str]] = []


class SessionView(BaseModel):
    """The signed-in owner and role, if any, and whether reading needs a token."""

    owner: str
    role: str = ""
    read_token: bool


class Health(BaseModel):
    """The state of the service, which may be up without a cluster."""

    status: Literal["ok"] = "ok"
    version: str
    cluster: bool

"""The records of the HTTP API: what the server sends and accepts, and what clients get.

Scores may be infinite; JSON knows no infinity, so they are the texts "-inf" and "inf" there.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from palpate.service.server.jobs.home import NAME_PATTERN

PREFIX = "/api/v1"

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Priority = Annotated[int, Field(ge=-100, le=100)]
Key = Annotated[str, Field(max_length=128, pattern=r"^[ -~]*$")]
State = Literal["waiting", "running", "paused", "finished", "failed", "cancelled"]


class Accepted(BaseModel):
    """What a client sends: an unknown key is an error."""

    model_config = ConfigDict(extra="forbid")


class StudySubmission(Accepted):
    """A study to be run.

    ``study`` is the text of a study file or its keys; images are named FOLDER/FILE as they
    were uploaded, or are volumes of the store. ``key``: a text of your own; submitting the
    same key again gives the same job. ``anyway``: run although a plausibility check fails.
    """

    study: str | dict[str, Any]
    priority: Priority = 0
    key: Key = ""
    accept_new_code: bool = False
    anyway: bool = False


class DiagnosisSource(Accepted):
    """What is diagnosed: an upload (FOLDER, or FOLDER/FILE), or a study of this service."""

    upload: Annotated[str, Field(max_length=200)] | None = None
    study: Name | None = None

    @model_validator(mode="after")
    def _one(self) -> "DiagnosisSource":
        if (self.upload is None) == (self.study is None):
            raise ValueError("give exactly one of upload and study")
        return self


class DiagnosisSubmission(Accepted):
    """A case, a study or an experiment to be diagnosed; ``effects``: those suspected, or all.

    ``anyway``: diagnose although a plausibility check fails.
    """

    source: DiagnosisSource
    nodes: Annotated[int, Field(ge=200, le=500_000)] = 5000
    effects: Annotated[list[Name], Field(min_length=1, max_length=100)] | None = None
    anyway: bool = False
    priority: Priority = 0
    key: Key = ""


class PriorityChange(Accepted):
    """Another priority of a job."""

    priority: Priority


class SignIn(Accepted):
    """A token, exchanged for a cookie that only this site gets."""

    token: Annotated[str, Field(min_length=1, max_length=512)]


class Problem(BaseModel):
    """Why a request was refused, and what to do."""

    error: str


class Evaluations(BaseModel):
    """How many evaluations of a study have ended in which way."""

    done: int = 0
    diverged: int = 0
    crashed: int = 0
    lost: int = 0
    reused: int = 0
    at_most: int = 0


class Best(BaseModel):
    """The best candidate so far; genes in their units at the door.

    ``objective`` is the label of the score that the search optimises, ``value`` its value.
    ``note`` says why it has not the lowest GSF, where that is so.
    """

    candidate: int
    genes: dict[str, float]
    score: dict[str, float | str | None]
    objective: str = "GSF"
    value: float | str | None = None
    note: str = ""


class Phase(BaseModel):
    """The step that a diagnosis is at: tasks that have ended, and all of them."""

    phase: str
    done: int
    of: int
    task: str = ""


class JobView(BaseModel):
    """A study or a diagnosis, and how far it is.

    ``reason`` says why it has failed, ``note`` why it is not running although it waits.
    ``journal_bytes`` is where its events go on; see /events.
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
    files: list[str] = []


class JobPage(BaseModel):
    """Some jobs, the last submitted first; ``more`` is the ``before`` of the next page."""

    jobs: list[JobView]
    more: int | None = None


class JournalPage(BaseModel):
    """Records of a journal; ``since`` of the next request."""

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


class WorkerView(BaseModel):
    """One worker: what it runs and has waiting, its load and its memory; a limit of 0 is none."""

    name: str
    address: str
    threads: int
    running: int
    waiting: int
    cpu_percent: float
    memory_bytes: int
    memory_limit_bytes: int


class ClusterView(BaseModel):
    """The cluster: tasks it can run at once, those under way or queued, Dask's own page."""

    ready: bool
    trouble: str = ""
    threads: int = 0
    tasks: int = 0
    dashboard: str = ""
    workers: list[WorkerView] = []


class SearchedParameterView(BaseModel):
    """A searched parameter in its unit at the door; ``target`` where it is known."""

    gene: str
    label: str
    unit: str
    lower: float
    upper: float
    target: float | None = None


class StudyView(BaseModel):
    """What a study asks: its parameters, and its file with all defaults.

    ``score``: the label of the minimised score, for an axis.
    """

    parameters: list[SearchedParameterView]
    score: str
    file: str


class BodiesView(BaseModel):
    """What the viewers of slices and of the body show, or that it is being made.

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
    """Who asks, and whether reading needs a token, too; a stranger has no owner and no role."""

    owner: str
    role: str = ""
    read_token: bool


class Health(BaseModel):
    """Whether the service is up; it may be up without a cluster."""

    status: Literal["ok"] = "ok"
    version: str
    cluster: bool

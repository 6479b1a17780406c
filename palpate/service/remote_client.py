"""A typed client of the HTTP API; the basis of `palpate.connect`.

A refused call raises a `PalpateError` with the service's message. The images of a study are
uploaded before the study is submitted.
"""

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx
from pydantic import BaseModel

from palpate.service.errors_and_interrupts import ClusterError
from palpate.service.server.api_models import (
    PREFIX,
    ClusterView,
    Health,
    JobPage,
    JobView,
    JournalPage,
    UploadList,
    UploadView,
)
from palpate.service.server.jobs.home_and_tokens import TOKEN_VARIABLE
from palpate.service.study.study_keys import StudySpec, read_spec
from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import file_digest
from palpate.storage.read_only import ReadOnly
from palpate.workers.common_keys import validated
from palpate.workers.input_files import check_regular

Record = TypeVar("Record", bound=BaseModel)

RETRY_S = 0.5
BLOCK_BYTES = 2**20
REFUSALS: dict[int, type[InputError] | type[StoreError]] = {409: StoreError, 413: StoreError}


@dataclass(frozen=True)
class JobEvent(ReadOnly):
    """One event of a followed job.

    Parameters
    ----------
    kind : {"job", "record", "end"}
    job : JobView or None
        The current state, if `kind` is job.
    record : dict
        A record of the job's journal, if `kind` is record.
    position : int
        Offset of the next record; `Client.follow` continues from there.
    """

    kind: str
    job: JobView | None
    record: dict[str, Any]
    position: int


class Client:
    """A connection to a service; use as a context manager, or close it.

    Parameters
    ----------
    url : str
        Such as ``"http://127.0.0.1:8780"``.
    token : str, optional
        Default: the variable PALPATE_TOKEN. Without a token, access is read-only.
    patience_s : float
        Time to keep retrying a service that does not answer; it may be restarting.
    """

    def __init__(self, url: str, token: str | None = None, *, patience_s: float = 60.0) -> None:
        self.url = url.rstrip("/")
        self.patience_s = patience_s
        given = os.environ.get(TOKEN_VARIABLE, "") if token is None else token
        headers = {"Authorization": f"Bearer {given}"} if given else {}
        try:
            self._http = httpx.Client(
                base_url=self.url + PREFIX, headers=headers, timeout=60.0, trust_env=False
            )
        except (ValueError, httpx.InvalidURL) as error:
            raise InputError(
                f"{url!r} is not an address of a service: expected e.g. http://127.0.0.1:8780."
            ) from error

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # The service

    def health(self) -> Health:
        """Return the state of the service."""
        return self._get(Health, "/health")

    def cluster(self) -> ClusterView:
        """Return the capacity and load of the cluster."""
        return self._get(ClusterView, "/cluster")

    # Jobs

    def submit_study(
        self,
        study: str | Mapping[str, Any],
        *,
        priority: int = 0,
        key: str = "",
        accept_new_code: bool = False,
        anyway: bool = False,
    ) -> JobView:
        """Queue a study, given as the text of its file or its keys.

        Raises
        ------
        InputError
            If it is not valid.
        """
        given = study if isinstance(study, str) else dict(study)
        body = {"study": given, "priority": priority, "key": key}
        body |= {"accept_new_code": accept_new_code, "anyway": anyway}
        return self._send(JobView, "/studies", body)

    def submit_diagnosis(
        self,
        *,
        upload: str | None = None,
        study: str | None = None,
        nodes: int = 5000,
        effects: list[str] | None = None,
        anyway: bool = False,
        priority: int = 0,
        key: str = "",
    ) -> JobView:
        """Queue the diagnosis of an upload, or of a study on the service."""
        source = {"upload": upload} if study is None else {"study": study}
        body = {"source": source, "nodes": nodes, "effects": effects, "anyway": anyway}
        return self._send(JobView, "/diagnoses", body | {"priority": priority, "key": key})

    def jobs(self, **filters: str) -> list[JobView]:
        """Return all jobs, newest first; filters: ``kind``, ``state``."""
        found: list[JobView] = []
        before: dict[str, Any] = {}
        while True:
            page = self._get(JobPage, "/jobs", **filters, **before, limit=200)
            found += page.jobs
            if page.more is None:
                return found
            before = {"before": page.more}

    def job(self, identifier: str) -> JobView:
        """Return the current state of a job."""
        return self._get(JobView, f"/jobs/{identifier}")

    def change(self, identifier: str, action: str) -> JobView:
        """Pause, resume or cancel a job."""
        return self._send(JobView, f"/jobs/{identifier}/{action}", None)

    def prioritise(self, identifier: str, priority: int) -> JobView:
        """Change the priority of a job."""
        answer = self._request("PATCH", f"/jobs/{identifier}", json={"priority": priority})
        return JobView.model_validate_json(answer.content)

    def results(self, identifier: str) -> dict[str, Any]:
        """Return the results of a job, as printed by `palpate report --json`."""
        found: dict[str, Any] = self._request("GET", f"/jobs/{identifier}/results").json()
        return found

    def candidate(self, identifier: str, number: int) -> dict[str, Any]:
        """Return the full record of one candidate of a study."""
        path = f"/jobs/{identifier}/candidates/{number}"
        found: dict[str, Any] = self._request("GET", path).json()
        return found

    def journal(self, identifier: str, since: int = 0) -> Iterator[dict[str, Any]]:
        """Yield the current records of a job's journal."""
        while True:
            page = self._get(JournalPage, f"/jobs/{identifier}/journal", since=since)
            if not page.records:
                return
            yield from page.records
            since = page.since

    def follow(self, identifier: str, since: int = 0) -> Iterator[JobEvent]:
        """Yield the events of a job until it ends, waiting for the service if it restarts.

        Raises
        ------
        ClusterError
            If the service does not come back.
        StoreError
            If the journal of the job is damaged.
        """
        position, lost = since, 0.0
        while True:
            try:
                for event in self._events(identifier, position):
                    position, lost = event.position, 0.0
                    yield event
                    if event.kind == "end":
                        return
            except httpx.TransportError:
                pass
            now = time.monotonic()
            lost = lost or now
            if now - lost > self.patience_s:
                raise self._gone()
            time.sleep(RETRY_S)

    def download(self, identifier: str, name: str, to: Path) -> Path:
        """Write a file of a job to a path.

        Raises
        ------
        InputError
            If the job has no such file.
        """
        with explained(to), self._http.stream("GET", f"/jobs/{identifier}/files/{name}") as answer:
            self._check(answer)
            with replacing(to) as temporary, temporary.open("wb") as file:
                for block in answer.iter_bytes(BLOCK_BYTES):
                    file.write(block)
        return to

    # Uploads

    def upload(self, path: Path, folder: str, name: str | None = None) -> UploadView:
        """Upload a file as FOLDER/NAME; repeating an upload is harmless.

        Raises
        ------
        InputError
            If it cannot be read, or is of an unknown kind.
        StoreError
            If it is too large, or another file has that name.
        """

        def blocks() -> Iterator[bytes]:
            with path.open("rb") as file:
                while block := file.read(BLOCK_BYTES):
                    yield block

        if not path.is_file():
            raise InputError(f"There is no file {path} to upload.")
        answer = self._request("PUT", f"/uploads/{folder}/{name or path.name}", content=blocks())
        return UploadView.model_validate_json(answer.content)

    def uploads(self) -> list[UploadView]:
        """Return all uploads."""
        return self._get(UploadList, "/uploads").uploads

    def remove_uploads(self, folder: str) -> None:
        """Remove a folder of uploads; no unfinished job may need it."""
        self._request("DELETE", f"/uploads/{folder}")

    def _events(self, identifier: str, since: int) -> Iterator[JobEvent]:
        timeout = httpx.Timeout(60.0, read=60.0)
        with self._http.stream(
            "GET", f"/jobs/{identifier}/events", params={"since": since}, timeout=timeout
        ) as answer:
            self._check(answer)
            kind, position = "", since
            for line in answer.iter_lines():
                field, _, value = line.partition(": ")
                if field == "event":
                    kind = value
                elif field == "id":
                    position = int(value)
                elif field == "data":
                    data = json.loads(value)
                    if kind == "problem":
                        raise StoreError(data["error"])
                    job = JobView.model_validate(data) if kind == "job" else None
                    yield JobEvent(kind, job, data if kind == "record" else {}, position)

    def _get(self, kind: type[Record], path: str, **parameters: Any) -> Record:
        return kind.model_validate_json(self._request("GET", path, params=parameters).content)

    def _send(self, kind: type[Record], path: str, body: Any) -> Record:
        return kind.model_validate_json(self._request("POST", path, json=body).content)

    def _request(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Send a request; retry one that is safe to repeat if there is no answer."""
        until = time.monotonic() + self.patience_s
        while True:
            try:
                answer = self._http.request(method, path, **more)
            except httpx.ConnectError as error:
                if time.monotonic() > until:
                    raise self._gone() from error
                time.sleep(RETRY_S)
            except httpx.TransportError as error:
                if method != "GET" or time.monotonic() > until:
                    raise self._gone() from error
                time.sleep(RETRY_S)
            else:
                self._check(answer)
                return answer

    def _check(self, answer: httpx.Response) -> None:
        if answer.is_success:
            return
        answer.read()
        reason = answer.text[:500]
        with suppress(ValueError, KeyError, TypeError):
            reason = str(answer.json()["error"])
        if answer.status_code >= 500:
            raise ClusterError(f"The service at {self.url} cannot do this now: {reason}")
        raise REFUSALS.get(answer.status_code, InputError)(reason)

    def _gone(self) -> ClusterError:
        return ClusterError(
            f"The service at {self.url} does not answer. Start it with `palpate serve`, or check "
            "the address; completed work is saved."
        )


IMAGE_KEYS = ("volume", "file", "labels")


def with_uploaded_images(
    client: Client, study: str | Path | Mapping[str, Any] | StudySpec
) -> dict[str, Any]:
    """Upload the local images of a study; return its keys with the names of the uploads.

    A folder of uploads is named after the content of the image.

    Raises
    ------
    InputError
        If the study is not valid, or an image cannot be read.
    """
    if isinstance(study, Mapping):
        study = validated(StudySpec, study, "The study")
    spec = study if isinstance(study, StudySpec) else read_spec(Path(study))
    data = spec.as_dict()
    _upload(client, data)
    return data


def _upload(client: Client, data: dict[str, Any]) -> None:
    for key, value in data.items():
        if isinstance(value, dict):
            _upload(client, value)
        elif key in IMAGE_KEYS and isinstance(value, str) and Path(value).expanduser().exists():
            data[key] = _uploaded(client, Path(value).expanduser())


def _uploaded(client: Client, path: Path) -> str:
    check_regular(path)
    folder = f"image-{file_digest(path)}"
    if path.is_file():
        client.upload(path, folder)
        return f"{folder}/{path.name}"
    files = sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
    if not files:
        raise InputError(f"{path} has no images.")
    for file in files:
        client.upload(file, folder)
    return folder

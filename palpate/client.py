"""A remote service: submit studies and diagnoses, follow them, read results."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console

from palpate.service.installed_packages import frame_type
from palpate.service.remote_client import Client, JobEvent, with_uploaded_images
from palpate.service.server.api_models import ClusterView, JobView
from palpate.service.study.study_keys import StudySpec
from palpate.storage.errors import InputError
from palpate.storage.json_digests import to_number

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = ["Job", "Service", "connect"]

ENDED = {"finished", "failed", "cancelled"}


def connect(url: str = "http://127.0.0.1:8780", token: str | None = None) -> "Service":
    """Connect to a service started by `palpate serve`.

    Parameters
    ----------
    url : str
    token : str, optional
        From `palpate token new NAME`; default: the variable PALPATE_TOKEN. Without a token,
        access is read-only.

    Raises
    ------
    InputError
        If `url` is not an address.
    ClusterError
        If the service does not answer.
    """
    client = Client(url, token, patience_s=5.0)
    try:
        client.health()
    except BaseException:
        client.close()
        raise
    client.patience_s = 120.0
    return Service(client)


class Service:
    """A service; see `connect`.

    Parameters
    ----------
    client : Client
    """

    def __init__(self, client: Client) -> None:
        self.client = client

    def submit(
        self,
        study: str | Path | Mapping[str, Any] | StudySpec,
        *,
        priority: int = 0,
        key: str = "",
        accept_new_code: bool = False,
        anyway: bool = False,
    ) -> "Job":
        """Queue a study; local images that it names are uploaded first.

        Parameters
        ----------
        study : path, mapping or StudySpec
            A study file, or its keys.
        priority : int
            From -100 to 100; studies with a higher priority get workers first.
        key : str
            Any text; submitting the same key again returns the same job.
        accept_new_code : bool
            Continue even if the code has changed since the study last ran.
        anyway : bool
            Run the study even though its inputs look implausible; its results say so.

        Raises
        ------
        InputError
            If the study is not valid, or an image cannot be read.
        """
        data = with_uploaded_images(self.client, study)
        job = self.client.submit_study(
            data, priority=priority, key=key, accept_new_code=accept_new_code, anyway=anyway
        )
        return Job(self.client, job)

    def diagnose(
        self,
        source: "str | Path | Job",
        *,
        nodes: int = 5000,
        effects: list[str] | None = None,
        anyway: bool = False,
        priority: int = 0,
        key: str = "",
    ) -> "Job":
        """Queue a diagnosis of a study on the service, or of a local folder of scans.

        Raises
        ------
        InputError
            If the folder has no files to upload.
        """
        options: dict[str, Any] = {"nodes": nodes, "effects": effects, "anyway": anyway}
        options |= {"priority": priority, "key": key}
        if isinstance(source, Job):
            return Job(self.client, self.client.submit_diagnosis(study=source.id, **options))
        folder = Path(source)
        files = sorted(p for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
        if not files:
            raise InputError(f"{folder} does not contain a case file and its scans.")
        for file in files:
            self.client.upload(file, folder.resolve().name)
        upload = folder.resolve().name
        return Job(self.client, self.client.submit_diagnosis(upload=upload, **options))

    def jobs(self) -> "list[Job]":
        """Return all studies and diagnoses, newest first."""
        return [Job(self.client, job) for job in self.client.jobs()]

    def job(self, identifier: str) -> "Job":
        """Return a job by its name on the service.

        Raises
        ------
        InputError
            If there is no such job.
        """
        return Job(self.client, self.client.job(identifier))

    def cluster(self) -> ClusterView:
        """Return the capacity and load of the cluster."""
        return self.client.cluster()

    def close(self) -> None:
        """Close the connection; jobs continue."""
        self.client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Job:
    """A study or a diagnosis on a service.

    Parameters
    ----------
    client : Client
    view : JobView
    """

    def __init__(self, client: Client, view: JobView) -> None:
        self.client = client
        self.id = view.id
        self._view = view

    def __repr__(self) -> str:
        return f"<palpate {self._view.kind} {self.id}: {self._view.state}>"

    def _repr_markdown_(self) -> str:
        return f"**{self.id}** {describe(self.status)}"

    @property
    def status(self) -> JobView:
        """Return the current state of the job."""
        self._view = self.client.job(self.id)
        return self._view

    def follow(self, since: int = 0) -> Iterator[JobEvent]:
        """Yield events, from the beginning or from a position, until the job ends."""
        for event in self.client.follow(self.id, since):
            self._view = event.job or self._view
            yield event

    def wait(self, *, progress: bool = False) -> JobView:
        """Wait for the job to end, then return it.

        Parameters
        ----------
        progress : bool
            Show a progress line, updated once a second, in notebooks too.

        Raises
        ------
        InputError
            If the job has failed; the message gives the reason.
        """
        console = Console(stderr=True, highlight=False)
        status = console.status(self.id) if progress else None
        if status is not None:
            status.start()
        try:
            for event in self.follow(self.status.journal_bytes):
                if status is not None and event.job is not None:
                    status.update(f"{self.id} {describe(event.job)}")
        finally:
            if status is not None:
                status.stop()
        if self._view.state == "failed":
            raise InputError(f"{self.id} has failed: {self._view.reason}")
        return self._view

    def pause(self) -> JobView:
        """Pause the job; completed work is saved."""
        return self.client.change(self.id, "pause")

    def resume(self) -> JobView:
        """Resume the job after a pause or a failure."""
        return self.client.change(self.id, "resume")

    def cancel(self) -> JobView:
        """Cancel the job permanently."""
        return self.client.change(self.id, "cancel")

    @property
    def results(self) -> dict[str, Any]:
        """Return the results of a study (see `palpate report --json`), or a diagnosis record."""
        return self.client.results(self.id)

    def candidates(self) -> list[dict[str, Any]]:
        """Return the records of all completed evaluations, in candidate order."""
        records = [r for r in self.client.journal(self.id) if r.get("kind") == "evaluation"]
        for record in records:
            record["score"] = to_number(record["score"])
        return sorted(records, key=lambda record: int(record["candidate"]))

    def table(self) -> "DataFrame":
        """Return `candidates` as a pandas table.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        rows = [
            {key: r[key] for key in ("candidate", "generation", "status", "reason")}
            | dict(r["genes"])
            | dict(r["score"] or {})
            for r in self.candidates()
        ]
        made: DataFrame = frame_type()(rows).set_index("candidate")
        return made

    def download(self, name: str, folder: str | Path = ".") -> Path:
        """Write a file of the job, such as report.html, into a folder; return its path."""
        return self.client.download(self.id, name, Path(folder) / name)


def describe(job: JobView) -> str:
    """Return the progress of a job as one line of text."""
    text = job.state + (f": {job.reason or job.note}" if job.reason or job.note else "")
    if job.evaluations is not None:
        ended = job.evaluations
        count = ended.done + ended.diverged + ended.crashed + ended.lost
        text += f", {count} of at most {ended.at_most} evaluations"
        if job.best is not None:
            text += f", best GSF {to_number(job.best.score.get('gsf')):.5g}"
    if job.phase is not None:
        text += f", {job.phase.phase} {job.phase.done} of {job.phase.of}"
    return text

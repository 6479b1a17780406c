"""Upper limits of a service."""

from dataclasses import dataclass

MIB = 2**20


@dataclass(frozen=True)
class Limits:
    """Limits of one service.

    Parameters
    ----------
    body_bytes : int
        Size of a request other than an upload.
    upload_bytes, uploads_bytes : int
        Size of one uploaded file, and of all uploads together.
    uploads_files : int
        Number of uploaded files.
    evaluations : int
        Number of evaluations in one study.
    population : int
        Number of candidates in one generation.
    open_streams : int
        Number of clients following events at once.
    waiting_jobs : int
        Number of jobs that have not ended.
    """

    body_bytes: int = 512 * 1024
    upload_bytes: int = 1024 * MIB
    uploads_bytes: int = 50 * 1024 * MIB
    uploads_files: int = 20_000
    evaluations: int = 500_000
    population: int = 20_000
    open_streams: int = 64
    waiting_jobs: int = 1000

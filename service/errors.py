"""Defines what can go wrong between the driver and its cluster.

::

    PalpateError
    |-- ClusterError      no scheduler, no workers, nothing finishes; exit code 2
    |-- TaskError         a preparation crashed on a worker; exit code 2
    `-- GenerationCrashError  all of a generation crashed for one reason; exit code 2

    Interrupted           the user asked to stop: no error; exit code 130
"""

from palpate.storage.errors import PalpateError


class ClusterError(PalpateError):
    """The cluster cannot do the work."""


class TaskError(PalpateError):
    """A task without which no study can start has crashed."""


class GenerationCrashError(PalpateError):
    """Every candidate of a generation has crashed for the same reason.

    Parameters
    ----------
    message : str
    traceback : str
        Of the first one, on its worker.
    """

    def __init__(self, message: str, traceback: str = "") -> None:
        super().__init__(message)
        self.traceback = traceback


class Interrupted(Exception):  # noqa: N818 - the user's wish, no error
    """Somebody asked the study to stop; what is journalled is kept."""

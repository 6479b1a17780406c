"""Errors between the driver and its cluster.

::

    PalpateError
    |-- ClusterError      no scheduler, no workers, nothing finishes; exit code 2
    |-- TaskError         a preparation crashed on a worker; exit code 2
    `-- GenerationCrashError  all of a generation crashed for one reason; exit code 2

    Interrupted           the user asked to stop: no error; exit code 130
"""

from palpate.storage.errors import PalpateError


class ClusterError(PalpateError):
    """A cluster that cannot do the work."""


class TaskError(PalpateError):
    """The crash of a task that a study cannot start without."""


class GenerationCrashError(PalpateError):
    """A crash of every candidate of a generation for the same reason.

    Parameters
    ----------
    message : str
    traceback : str
        Traceback of the first one, from its worker.
    """

    def __init__(self, message: str, traceback: str = "") -> None:
        super().__init__(message)
        self.traceback = traceback


class Interrupted(Exception):  # noqa: N818 - a request, not an error
    """A request to stop the study; completed evaluations are saved."""

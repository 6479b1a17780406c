"""A service as a whole: its home, queue, runner, uploads, tokens and limits."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from palpate.service.server.jobs.home import ServiceHome
from palpate.service.server.jobs.limits import Limits
from palpate.service.server.jobs.queue import Queue
from palpate.service.server.jobs.runner import OpenCluster, Runner
from palpate.service.server.jobs.tokens import Tokens, take_token
from palpate.service.server.jobs.uploads import Uploads
from palpate.service.server.live.bodies import BodiesMaker
from palpate.service.server.live.cluster_load import ClusterLoad
from palpate.service.server.live.job_progress import ProgressBook
from palpate.service.study.loop import Tasks
from palpate.storage.backends.places import Location, place_of
from palpate.storage.stores.store import Store, open_store


@dataclass(frozen=True, eq=False)
class Service:
    """All parts of a service.

    Parameters
    ----------
    read_token : bool
        Whether reading needs a token as well.
    """

    home: ServiceHome
    store: Store
    queue: Queue
    runner: Runner
    uploads: Uploads
    tokens: Tokens
    progress: ProgressBook
    limits: Limits
    read_token: bool
    bodies: BodiesMaker
    load: ClusterLoad


@contextmanager
def open_service(
    root: Path,
    open_cluster: OpenCluster,
    *,
    store: Location | None = None,
    limits: Limits | None = None,
    read_token: bool = False,
    tasks: Tasks | None = None,
    at_once: int = 8,
    reports: bool = True,
) -> Iterator[Service]:
    """Open the service in a folder and run its waiting jobs until it is closed.

    Parameters
    ----------
    root : Path
        Created if missing.
    open_cluster : callable
        Opens the cluster.
    store : str or Path, optional
        Default: the folder ``store`` in `root`.
    tasks : Tasks, optional
        Functions sent to the workers.
    at_once : int
        Number of jobs run at the same time.
    reports : bool
        Write the page of a completed study.

    Raises
    ------
    StoreError
        If folder or store cannot be used, or another service is using them.
    """
    given = take_token()  # before any process inherits it
    limits, root = limits or Limits(), root.expanduser().absolute()
    home = ServiceHome(root, place_of(store or root / "store"))
    home.make()
    opened = open_store(home.store)
    queue = Queue(home.queue)
    try:
        uploads = Uploads(home.uploads, limits)
        runner = Runner(
            home, queue, uploads, open_cluster, tasks=tasks, at_once=at_once, reports=reports
        )
        tokens, bodies = Tokens(home.tokens, given), BodiesMaker()
        runner.start()
        try:
            yield Service(
                home,
                opened,
                queue,
                runner,
                uploads,
                tokens,
                ProgressBook(),
                limits,
                read_token,
                bodies,
                ClusterLoad(lambda: runner.cluster),
            )
        finally:
            bodies.close()
            runner.stop()
    finally:
        queue.close()

"""A service as a separate process: FOLDER, then --scheduler ADDRESS or --workers N.

Use --store=PLACE for a store outside FOLDER. Its tasks are the stand-ins of tests/recovery;
--bodies selects stand-ins that also store bodies, --real the real tasks. It writes its address to
FOLDER/url.
"""

import sys
from pathlib import Path

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.errors_and_interrupts import stop_requests
from palpate.service.server.http.http_server import listen, serve, url_of
from palpate.service.server.jobs.untrusted_inputs import Limits
from palpate.service.server.running_service import open_service
from palpate.storage.backends.atomic_files import write_file
from tests.recovery.stand_ins import TASKS
from tests.service.server import with_bodies

LIMITS = Limits(upload_bytes=2**20, uploads_bytes=4 * 2**20, body_bytes=2**17)


def main(folder: str, where: str, value: str, port: str = "0", *more: str) -> None:
    options = {"scheduler": value} if where == "--scheduler" else {"workers": int(value)}
    tasks = with_bodies.TASKS if "--bodies" in more else TASKS
    with (
        stop_requests() as requests,
        listen("127.0.0.1", int(port)) as listening,
        open_service(
            Path(folder),
            lambda: open_cluster(**options),
            store=next((m.partition("=")[2] for m in more if m.startswith("--store=")), None),
            tasks=None if "--real" in more else tasks,
            reports="--real" in more,
            limits=LIMITS,
            read_token="--read-token" in more,
        ) as service,
    ):
        write_file(Path(folder) / "url", url_of(listening).encode())
        serve(service, listening, stop=lambda: requests)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""A driver in a separate process: FOLDER, --scheduler ADDRESS or --workers N, [STORE]."""

import sys
from pathlib import Path

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from tests.recovery.stand_ins import run


def main(folder: str, where: str, value: str, store: str | None = None) -> None:
    options = {"scheduler": value} if where == "--scheduler" else {"workers": int(value)}
    with open_cluster(**options) as cluster:
        run(Path(folder), Dispatcher(cluster.client), store=store)


if __name__ == "__main__":
    main(*sys.argv[1:])

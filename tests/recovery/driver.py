"""A driver in a process of its own: FOLDER, then --scheduler ADDRESS or --workers N."""

import sys
from pathlib import Path

from stand_ins import run

from service.cluster import open_cluster
from service.dispatch import Dispatcher


def main(folder: str, where: str, value: str) -> None:
    options = {"scheduler": value} if where == "--scheduler" else {"workers": int(value)}
    with open_cluster(**options) as cluster:
        run(Path(folder), Dispatcher(cluster.client))


if __name__ == "__main__":
    main(*sys.argv[1:])

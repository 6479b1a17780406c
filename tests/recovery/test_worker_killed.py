"""Workers killed with signal 9: finished evaluations are kept, unfinished ones repeated."""

import os
import random
import signal
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, set_manners, told


def test_five_workers_killed(tmp_path: Path) -> None:
    run(tmp_path / "undisturbed" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    store = folder.parent / "store"
    set_manners(store, seconds=0.2, held_after=40)
    killed: list[int] = []
    over = threading.Event()

    def kill(client: Any) -> None:
        chance = random.Random(5)
        try:
            while len(killed) < 5 and not over.wait(chance.uniform(0.2, 0.6)):
                pids = client.run(os.getpid, on_error="ignore").values()
                alive = sorted(set(pids) - set(killed))
                with suppress(ProcessLookupError):  # it may already be ending
                    if alive:
                        os.kill(victim := chance.choice(alive), signal.SIGKILL)
                        killed.append(victim)
        finally:
            set_manners(store, seconds=0.2)

    with open_cluster(workers=2) as cluster:
        killer = threading.Thread(target=kill, args=(cluster.client,))
        killer.start()
        run(folder, Dispatcher(cluster.client))
        over.set()
        killer.join()
    assert len(killed) == 5
    assert told(folder) == told(tmp_path / "undisturbed" / "demo")
    assert_each_ran_once(folder, cut_off=5)

"""The candidates of a study do not depend on where its evaluations run."""

import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import palpate
import palpate.study
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.study.loop import Study as StudyLoop
from tests.recovery.stand_ins import TASKS, assert_each_ran_once, small_spec, told


@pytest.fixture(autouse=True)
def _tasks_take_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(palpate.study, "StudyLoop", partial(StudyLoop, tasks=TASKS))


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Provide a client of the cluster that a study would start by default."""
    with open_cluster(workers=2) as cluster:
        yield cluster.client


def run(folder: Path, **where: Any) -> dict[int, tuple[Any, ...]]:
    palpate.Study(small_spec(), folder).run(**where)
    assert_each_ran_once(folder)
    return told(folder)


def test_cluster_client_and_process_give_equal_candidates(client: Any, tmp_path: Path) -> None:
    here = run(tmp_path / "here" / "demo", in_process=True)
    assert len(here) > 30
    assert run(tmp_path / "client" / "demo", client=client) == here
    assert client.status == "running"  # stays open


def test_rejects_several_places_at_once(client: Any, tmp_path: Path) -> None:
    study = palpate.Study(small_spec(), tmp_path / "demo")
    with pytest.raises(palpate.InputError, match="workers and in_process"):
        study.run(workers=2, in_process=True)
    with pytest.raises(palpate.InputError, match="scheduler and client"):
        study.run(scheduler="tcp://nowhere:1", client=client)


SCRIPT = """
from functools import partial
import palpate.study
from palpate.service.study.loop import Study as StudyLoop
from tests.recovery.stand_ins import TASKS, small_spec

palpate.service.study.loop.Study = partial(StudyLoop, tasks=TASKS)
print(palpate.study.Study(small_spec(), "runs/demo").run(in_process=True).stop_reason)
"""


@pytest.mark.slow
def test_no_main_guard_is_needed_in_process(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "all 5 generations are done" in done.stdout

"""Evaluations that hang: retried, then failed with a reason."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.storage.store import open_store
from tests.recovery.stand_ins import SPEC, Inline, run, set_manners, small_spec, told

TEXT = SPEC.replace("population: 12", "population: 6").replace("generations: 5", "generations: 1")
DEADLINE = small_spec(TEXT + "deadline_s: 4\n")


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with open_cluster(workers=2) as cluster:
        yield cluster.client


def second_largest(folder: Path) -> float:
    """Return an E_fat between the two largest of the undisturbed run, MPa."""
    fats = sorted(genes["E_fat_kpa"] for genes, *_ in told(folder).values())
    return float((fats[-2] + fats[-1]) / 2) / 1000


@pytest.mark.slow
def test_hanging_evaluation_is_retried_then_fails(client: Any, tmp_path: Path) -> None:
    calm, folder = tmp_path / "calm" / "study", tmp_path / "runs" / "study"
    run(calm, Inline(), DEADLINE)
    between = second_largest(calm)
    set_manners(tmp_path / "runs" / "store", hang_above=between)
    run(folder, Dispatcher(client), DEADLINE)
    endings, expected = told(folder), told(calm)
    (hung,) = [c for c in endings if endings[c] != expected[c]]
    *_, status, score, reason = endings[hung]
    assert (status, score) == ("diverged", None)
    assert reason == "no result within 4 s in any of 2 attempts"
    store = open_store(tmp_path / "runs" / "store")
    assert not list((store.root / "overruns").iterdir())


def test_evaluation_that_hangs_once_has_its_score(client: Any, tmp_path: Path) -> None:
    calm, folder = tmp_path / "calm" / "study", tmp_path / "runs" / "study"
    run(calm, Inline(), DEADLINE)
    set_manners(tmp_path / "runs" / "store", hang_once_above=second_largest(calm))
    run(folder, Dispatcher(client), DEADLINE)
    assert told(folder) == told(calm)
    assert len(list((tmp_path / "runs" / "store").glob("hung-*"))) == 1


def test_without_a_deadline_nothing_changes() -> None:
    assert "deadline_s" not in small_spec(SPEC).as_dict()
    assert DEADLINE.as_dict()["deadline_s"] == 4

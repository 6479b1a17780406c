"""Task results in a folder or a bucket: written whole, typed, and only once."""

from dataclasses import dataclass

import numpy as np
import pytest

from palpate.storage.errors import StoreError
from palpate.storage.values import Volume
from palpate.workers.tasks.task_store import Part, TaskStore


@dataclass(frozen=True)
class Fit:
    cost: float
    converged: bool


@dataclass(frozen=True)
class Other:
    name: str


@pytest.fixture(params=["folder", "bucket"])
def tasks(request, tmp_path):
    folder = request.param == "folder"
    return TaskStore(tmp_path / "s" if folder else request.getfixturevalue("bucket") + "/s")


def test_part_is_written_once_and_typed(tasks):
    part, arrays = Part(tasks, "p1"), {"z": np.arange(6.0), "kept": np.array([True, False])}
    assert not part.is_finished
    part.save(Fit(float("-inf"), True), arrays)
    part.save(Fit(1.0, False), {})  # the first part is kept
    assert part.is_finished
    assert str(part.path).endswith("/fields/p1.zarr")
    record, read = part.load(Fit)
    assert record == part.record(Fit) == Fit(float("-inf"), True)
    assert all((read[name] == arrays[name]).all() for name in arrays)
    with pytest.raises(StoreError, match="has unexpected content"):
        part.record(Other)


def test_volume_is_named_after_its_content_and_read_once(tasks):
    volume = Volume(np.ones((3, 4, 5), np.uint8), (1.0, 1.0, 2.0))
    name = tasks.add_volume(volume)
    assert tasks.add_volume(volume) == name
    assert (tasks.volume(name).values == volume.values).all()
    assert tasks.volume(name) is tasks.volume(name)

"""One contract for every kind of store: local folders and buckets.

An object with a name is complete, if two writers use the same name one of them wins, and data are
read back bit for bit.
"""

import json
import math
import uuid
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from palpate.storage.backends.store_paths import Place, place_of
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.store import (
    Store,
    backend_of,
    load_evaluation,
    open_store,
    probe_store,
    save_evaluation,
)
from palpate.storage.stored_arrays import (
    copy_entry,
    has_arrays,
    has_field,
    has_mesh,
    has_volume,
    list_volumes,
    load_arrays,
    load_field,
    load_mesh,
    load_meta,
    load_volume,
    save_arrays,
    save_field,
    save_mesh,
    save_volume,
    volume_meta,
)
from palpate.storage.upkeep import check_store, set_aside
from tests.storage.stores_at_hand import labels, run_python, same_bits

RNG = np.random.default_rng(3)
MANY = {
    "nodes": RNG.normal(size=(11, 3)),
    "tets": RNG.integers(0, 11, (7, 4), dtype=np.int32),
    "wall": np.empty(0, np.int32),
    "size_mm": np.array(6.5),
    "odd": np.array([-0.0, np.nan, np.inf, 5e-324]),
    "volume": RNG.integers(0, 6, (130, 20, 9), dtype=np.uint8),
}


@pytest.fixture(params=["folder", "s3", "gs", "az"])
def location(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> str:
    """Location of a new store; for Google and Azure, obstore's stand-ins on disk and in memory."""
    if request.param == "folder":
        return str(tmp_path / "deep" / "store")
    if request.param == "s3":
        return request.getfixturevalue("bucket") + "/deep/store"
    obstore = pytest.importorskip("obstore.store")
    name, stand_in = {
        "gs": ("GCSStore", obstore.LocalStore(tmp_path / "objects", mkdir=True)),
        "az": ("AzureStore", obstore.MemoryStore()),
    }[request.param]
    monkeypatch.setattr(obstore, name, lambda *_, **__: stand_in)
    return f"{request.param}://tests-{uuid.uuid4().hex[:12]}/deep/store"


@pytest.fixture
def store(location: str) -> Store:
    return open_store(location)


def groups(store: Store) -> list[str]:
    return [entry.place.name for entry in store.backend.entries(store.layout.fields)]


# --- the store ------------------------------------------------------------------------


def test_store_is_created_once_and_reopened(location: str) -> None:
    with pytest.raises(StoreError, match="is not a store"):
        open_store(location, create=False)
    made = open_store(location)
    assert str(made) == location
    assert json.loads(made.backend.read(made.layout.marker))["schema_version"] == 1
    assert open_store(location, create=False) == open_store(location) == made


def test_newer_store_is_unchanged(location: str) -> None:
    marker = place_of(location) / "palpate-store.json"
    text = b'{"schema_version": 2, "sharded": true}'
    if isinstance(marker, Path):
        marker.parent.mkdir(parents=True)
    backend_of(marker).write(marker, text)
    for create in (True, False):
        with pytest.raises(NewerSchemaError, match=r"schema 2.*Upgrade"):
            open_store(location, create=create)
    assert backend_of(marker).read(marker) == text


def test_damaged_description_gives_advice(store: Store) -> None:
    store.backend.write(store.layout.marker, b"{")
    with pytest.raises(StoreError, match=r"damaged.*Remove that file"):
        open_store(str(store))


def test_all_contents_round_trip(store: Store) -> None:
    volume, field = labels(), RNG.normal(size=(9, 3))
    assert list_volumes(store) == []
    save_volume(store, "v1", volume, meta={"name": "mine"})
    save_mesh(store, "m1", MANY, {"facts": {"gsf": -math.inf}})
    save_field(store, "e1", field)
    save_evaluation(store, "e1", {"digest": "e1", "status": "done", "score": {"gsf": -math.inf}})
    assert list_volumes(store) == ["v1"]
    assert same_bits(load_volume(store, "v1").values, volume.values)
    assert volume_meta(store, "v1")["name"] == "mine"
    arrays, meta = load_mesh(store, "m1")
    assert list(arrays) == list(MANY)
    assert all(same_bits(arrays[name], MANY[name]) for name in MANY)
    assert meta == {"facts": {"gsf": -math.inf}}
    assert same_bits(load_field(store, "e1"), field)
    record = load_evaluation(store, "e1")
    assert record is not None
    assert record["score"] == {"gsf": -math.inf}
    assert load_evaluation(store, "e2") is None
    assert not has_volume(store, "v2")
    assert not has_mesh(store, "v1")
    assert has_field(store, "e1")


def test_reports_missing_or_damaged_entries(store: Store) -> None:
    with pytest.raises(StoreError, match="not in the store"):
        load_field(store, "none")
    save_field(store, "f", np.zeros((4, 3)))
    with pytest.raises(StoreError, match="no array 'walls'"):
        load_arrays(store.layout.field("f"), ["walls"])
    store.backend.write(store.layout.field("f") / "zarr.json", b"{}")
    with pytest.raises(StoreError, match="damaged"):
        load_field(store, "f")
    store.backend.write(store.layout.evaluation("e"), b"{")
    with pytest.raises(StoreError, match="damaged"):
        load_evaluation(store, "e")


def chunks(store: Store, place: Place) -> list[Place]:
    """Return the files of a group that contain numbers."""
    if isinstance(place, Path):
        return [p for p in place.rglob("*") if p.is_file() and p.name != "zarr.json"]
    import obstore

    from palpate.storage.backends.bucket_client import client_of

    found = [o["path"] for page in obstore.list(client_of(place), place.key) for o in page]
    return [replace(place, key=key) for key in found if not key.endswith("zarr.json")]


def test_detects_lost_chunk(store: Store) -> None:
    save_field(store, "f", np.ones((4, 3)))
    (chunk,) = chunks(store, store.layout.field("f"))
    store.backend.remove(chunk)
    with pytest.raises(StoreError, match="checksum"):
        load_field(store, "f")


# --- one wins -------------------------------------------------------------------------


def test_first_writer_of_a_name_wins(store: Store) -> None:
    save_field(store, "f", np.zeros((2, 3)))
    save_field(store, "f", np.ones((2, 3)))
    assert not load_field(store, "f").any()


def test_concurrent_writers_of_one_name_leave_one_whole_group(store: Store) -> None:
    together = Barrier(4)

    def write(value: int) -> None:
        for number in range(5):
            together.wait()
            save_field(store, f"f{number}", np.full((400, 3), float(value)))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, range(4)))
    for number in range(5):
        field = load_field(store, f"f{number}")
        assert (field == field[0, 0]).all()
    assert groups(store) == [f"f{number}.zarr" for number in range(5)]
    assert all(len(chunks(store, store.layout.field(f"f{n}"))) == 1 for n in range(5))


def test_only_one_of_many_creates_a_name(store: Store) -> None:
    together = Barrier(8)

    def create(who: int) -> bool:
        together.wait()
        return store.backend.create(store.layout.lock("one"), b"%d" % who)

    with ThreadPoolExecutor(8) as pool:
        won = list(pool.map(create, range(8)))
    assert sum(won) == 1
    assert store.backend.read(store.layout.lock("one")) == b"%d" % won.index(True)
    assert store.backend.remove(store.layout.lock("one"))
    assert store.backend.create(store.layout.lock("one"), b"next")


@pytest.mark.parametrize("arrives", [False, True], ids=["lost on the way", "response lost"])
def test_interrupted_creation_is_retried(
    bucket: str, monkeypatch: pytest.MonkeyPatch, arrives: bool
) -> None:
    """The client does not retry conditional requests, because their outcome is unknown."""
    obstore = pytest.importorskip("obstore")
    store, put, tries = open_store(bucket + "/cut"), obstore.put, []

    def cut_off(*given: Any, **how: Any) -> Any:
        tries.append(given)
        if len(tries) > 1:
            return put(*given, **how)
        if arrives:
            put(*given, **how)
        raise obstore.exceptions.GenericError("HTTP error: error sending request")

    monkeypatch.setattr(obstore, "put", cut_off)
    assert store.backend.create(store.layout.lock("one"), b"mine")
    assert len(tries) == 2
    assert store.backend.read(store.layout.lock("one")) == b"mine"
    assert not store.backend.create(store.layout.lock("one"), b"another's")


KILLED = """
import os, sys
import numpy as np
from palpate.storage.backends import atomic_files, bucket_backend
from palpate.storage.stored_arrays import save_field
from palpate.storage.store import open_store

store = open_store(sys.argv[1])
def die(*_):
    os.kill(os.getpid(), 9)
atomic_files.os.rename = bucket_backend.create = die  # the step that publishes
save_field(store, "f", np.ones((4, 3)))
"""


@pytest.mark.parametrize("location", ["folder", "s3"], indirect=True)
def test_killed_writer_leaves_nothing_readable(store: Store) -> None:
    assert run_python(KILLED, str(store)).returncode == -9
    assert not has_field(store, "f")
    (left,) = store.backend.entries(store.layout.fields)
    assert left.half_written
    assert [str(place) for place in check_store(store).leftovers] == [str(left.place)]
    save_field(store, "f", np.zeros((2, 3)))
    assert has_field(store, "f")


# --- upkeep ---------------------------------------------------------------------------


def test_entries_are_listed_moved_and_removed(store: Store) -> None:
    for name in ("b", "a"):
        save_field(store, name, np.ones((50, 3)))
    save_evaluation(store, "a", {"digest": "a", "status": "diverged"})
    assert groups(store) == ["a.zarr", "b.zarr"]
    field = store.layout.field("a")
    assert store.backend.size_bytes(field) > 100
    assert store.backend.size_bytes(store.layout.evaluation("a")) > 10
    store.backend.move(field, store.root / "damaged" / "fields" / "a.zarr")
    assert groups(store) == ["b.zarr"]
    moved, _ = load_arrays(store.root / "damaged" / "fields" / "a.zarr")
    assert moved["displacement_mm"].all()
    assert store.backend.remove(store.layout.field("b"))
    assert not store.backend.remove(store.layout.field("b"))
    assert groups(store) == []


def test_damaged_entries_are_found_and_set_aside(store: Store) -> None:
    for name in ("a", "b", "c"):
        save_field(store, name, np.ones((4, 3)))
        save_evaluation(store, name, {"digest": name, "status": "done"})
    (chunk,) = chunks(store, store.layout.field("a"))
    store.backend.write(chunk, b"x")
    store.backend.remove(store.layout.field("b"))
    found = check_store(store)
    assert found.counts == {"volumes": 0, "meshes": 0, "fields": 2, "evaluations": 3}
    assert sorted(damage.path.name for damage in found.damages) == ["a.json", "a.zarr", "b.json"]
    aside = set_aside(store, found.damages)
    assert check_store(store).damages == []
    assert len(store.backend.entries(aside / "evaluations")) == 2


def test_copies_are_identical(store: Store, tmp_path: Path) -> None:
    save_mesh(store, "m", MANY, {"facts": {}})
    save_evaluation(store, "e", {"digest": "e", "status": "done"})
    other = open_store(tmp_path / "other")
    copy_entry(store.layout.mesh("m"), other.layout.mesh("m"))
    copy_entry(store.layout.evaluation("e"), other.layout.evaluation("e"))
    assert all(same_bits(load_mesh(other, "m")[0][name], MANY[name]) for name in MANY)
    assert load_evaluation(other, "e") == load_evaluation(store, "e")
    copy_entry(other.layout.mesh("m"), store.layout.mesh("back"))
    assert load_meta(store.layout.mesh("back")) == {"facts": {}}


def test_probe_leaves_nothing_behind(location: str) -> None:
    probe = probe_store(location)
    assert probe.takes_once
    assert probe.root == location
    store = open_store(location, create=False)
    assert store.backend.entries(store.layout.locks) == []
    assert (probe.free_bytes is None) == ("://" in location)


def test_groups_are_identical_in_both_backends(store: Store) -> None:
    save_arrays(store.layout.field("x"), {"a": np.asfortranarray(RNG.normal(size=(3, 4, 5)))})
    assert has_arrays(store.layout.field("x"))
    assert load_arrays(store.layout.field("x"))[0]["a"].flags.c_contiguous

"""Entries of a store that are exchanged are noticed by the check and by the next reader."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.storage.errors import StoreError
from palpate.storage.store import Store, load_evaluation, open_store, save_evaluation
from palpate.storage.stored_arrays import (
    copy_entry,
    has_sealed_name,
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
from tests.storage.stores_at_hand import labels

A, B = "3f2a9c0d1b7e6a54", "0123456789abcdef"
EXCHANGED = "files of this store were exchanged|entries of this store were exchanged"

# Kind of entry: path in the layout, and its readers.
READERS: dict[str, tuple[Callable[[Store, str], Path], tuple[Callable[[Store, str], Any], ...]]] = {
    "volume": (lambda store, name: store.layout.volume(name), (load_volume, volume_meta)),
    "mesh": (lambda store, name: store.layout.mesh(name), (load_mesh,)),
    "field": (lambda store, name: store.layout.field(name), (load_field,)),
    "part": (
        lambda store, name: store.layout.field(f"part-{name}"),
        (
            lambda store, name: load_meta(store.layout.field(f"part-{name}")),
            lambda store, name: load_arrays(store.layout.field(f"part-{name}")),
        ),
    ),
    "evaluation": (lambda store, name: store.layout.evaluation(name), (load_evaluation,)),
}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Provide a store with two entries of each kind that differ in content only."""
    store = open_store(tmp_path / "store")
    for number, name in enumerate((A, B)):
        save_volume(store, name, labels(seed=number))
        save_mesh(store, name, {"nodes": np.full((4, 3), number, dtype=float)}, {"volume": name})
        save_field(store, name, np.full((4, 3), number, dtype=float))
        save_arrays(store.layout.field(f"part-{name}"), {}, {"made": name})
        record = {"digest": name, "status": "done", "score": {"gsf": -1.0 - number}}
        save_evaluation(store, name, record)
    return store


def swap(one: Path, other: Path) -> list[Path]:
    aside = one.with_name("aside")
    one.rename(aside)
    other.rename(one)
    aside.rename(other)
    return [one, other]


def overwrite(one: Path, other: Path) -> list[Path]:
    remove(other)
    copy(one, other)
    return [other]


def rename(one: Path, other: Path) -> list[Path]:
    new = one.with_stem("fedcba9876543210")
    one.rename(new)
    return [new]


def duplicate(one: Path, other: Path) -> list[Path]:
    new = one.with_stem("fedcba9876543210")
    copy(one, new)
    return [new]


def copy(one: Path, other: Path) -> None:
    (shutil.copytree if one.is_dir() else shutil.copy)(one, other)


def remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize("edit", [swap, overwrite, rename, duplicate])
@pytest.mark.parametrize("kind", READERS)
def test_exchanged_entries_are_noticed(
    store: Store, kind: str, edit: Callable[[Path, Path], list[Path]]
) -> None:
    place, readers = READERS[kind]
    assert check_store(store).damages == []
    wrong = edit(place(store, A), place(store, B))
    damages = {damage.path: damage.reason for damage in check_store(store).damages}
    for path in wrong:
        name = path.stem.removeprefix("part-")
        assert "were exchanged" in damages[path]
        if kind != "part" or name in (A, B):
            for read in readers:
                with pytest.raises(StoreError, match=EXCHANGED):
                    read(store, name)
    set_aside(store, check_store(store).damages)
    assert check_store(store).damages == []


@pytest.mark.parametrize("other", ["meshes", "volumes"])
def test_an_entry_among_those_of_another_kind_is_noticed(store: Store, other: str) -> None:
    """Field, volume and record of an evaluation have one digest."""
    wrong = store.root / other / f"{B}.zarr"
    overwrite(store.layout.field(A), wrong)
    (damage,) = (d for d in check_store(store).damages if d.path == wrong)
    assert f"it was written as fields/{A}, so entries of this store were exchanged" in damage.reason
    assert "Put it back under that name, or set it aside with `palpate store check" in damage.reason


def test_exchanged_descriptions_are_noticed(store: Store) -> None:
    for kind in ("volume", "mesh", "field"):
        place, (read, *_) = READERS[kind]
        swap(place(store, A) / "zarr.json", place(store, B) / "zarr.json")
        with pytest.raises(StoreError, match=EXCHANGED):
            read(store, A)


def test_a_name_is_sealed(store: Store) -> None:
    overwrite(store.layout.field(A), store.layout.field(B))
    description = store.layout.field(B) / "zarr.json"
    description.write_text(description.read_text().replace(f"fields/{A}", f"fields/{B}"))
    with pytest.raises(StoreError, match="the checksum of its name is wrong"):
        load_field(store, B)


def as_before(path: Path) -> None:
    """Leave out what earlier versions did not write."""
    description = json.loads((path / "zarr.json").read_text())
    for key in ("name", "name_checksum"):
        del description["attributes"][key]
    (path / "zarr.json").write_text(json.dumps(description))


def test_entries_of_earlier_versions_are_readable_and_counted(store: Store, tmp_path: Path) -> None:
    assert check_store(store).unnamed == 0
    old = store.layout.field(A)
    as_before(old)
    assert load_field(store, A).tolist() == [[0.0] * 3] * 4
    checked = check_store(store)
    assert (checked.damages, checked.unnamed) == ([], 1)
    copies = open_store(tmp_path / "copies")
    for name in (A, B):
        copy_entry(store.layout.field(name), copies.layout.field(name))
    assert not has_sealed_name(copies.layout.field(A))
    assert has_sealed_name(copies.layout.field(B))


def test_exchanged_evaluations_of_earlier_versions_are_noticed(store: Store) -> None:
    """Their records have no checksum, but state their digest."""
    for name in (A, B):
        path = store.layout.evaluation(name)
        record = json.loads(path.read_text())
        del record["checksum"]
        path.write_text(json.dumps(record))
        assert load_evaluation(store, name)["digest"] == name
    swap(store.layout.evaluation(A), store.layout.evaluation(B))
    with pytest.raises(StoreError, match=f"it holds the evaluation {B}"):
        load_evaluation(store, A)

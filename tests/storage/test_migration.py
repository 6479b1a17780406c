"""An older store is refused until it has been migrated; an interrupted step is repeated."""

import pytest

from palpate.storage import store as stores
from palpate.storage import upkeep
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.store import Store, open_store, save_evaluation, stored_schema
from palpate.storage.upkeep import maintaining, migrate


@pytest.fixture(params=["folder", "bucket"])
def old(request, tmp_path, monkeypatch) -> Store:
    """A store with schema 1, when the current one is 3."""
    folder = request.param == "folder"
    place = str(tmp_path / "store") if folder else request.getfixturevalue("bucket") + "/store"
    store = open_store(place)
    save_evaluation(store, "e", {"digest": "e", "status": "done"})
    monkeypatch.setattr(stores, "SCHEMA_VERSION", 3)
    return store


def test_current_store_is_unchanged(tmp_path):
    store = open_store(tmp_path / "store")
    assert migrate(tmp_path / "store") == (1, 1)
    assert list(store.layout.root.iterdir()) != []
    with pytest.raises(StoreError, match="is not a store: it is missing"):
        migrate(tmp_path / "nowhere")


def test_older_store_names_the_command_and_is_migrated_step_by_step(old, monkeypatch):
    for create in (True, False):
        with pytest.raises(StoreError, match=r"older schema \(1; .* 3\).*palpate store migrate"):
            open_store(str(old), create=create)
    ran = []

    def first(store: Store) -> None:
        ran.append(1)
        store.backend.write(store.layout.evaluation("added"), b"{}")

    def second(store: Store) -> None:
        ran.append(2)
        if ran.count(2) == 1:
            raise StoreError("the disk is full")

    monkeypatch.setattr(upkeep, "STEPS", {1: first, 2: second})
    with pytest.raises(StoreError, match="disk is full"):
        migrate(str(old))
    assert stored_schema(old) == 2  # the first step is not repeated
    assert migrate(str(old)) == (2, 3)
    assert ran == [1, 2, 2]
    assert open_store(str(old), create=False) == old
    monkeypatch.setattr(stores, "SCHEMA_VERSION", 1)
    with pytest.raises(NewerSchemaError, match="Upgrade"):
        migrate(str(old))


def test_only_one_process_maintains_a_store(old, monkeypatch):
    monkeypatch.setattr(upkeep, "STEPS", {1: lambda store: None, 2: lambda store: None})
    with (
        maintaining(old, "palpate store gc --delete"),
        pytest.raises(StoreError, match=r"maintained by `palpate store gc --delete` \(process"),
    ):
        migrate(str(old))
    assert stored_schema(old) == 1
    assert migrate(str(old)) == (1, 3)
    assert old.backend.entries(old.layout.locks) == []

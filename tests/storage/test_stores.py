"""A store is created if possible, or refused with the reason."""

import json
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from palpate.storage.backends.store_paths import StoreLayout, StudyLayout
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import list_volumes, load_volume, save_volume
from tests.storage.stores_at_hand import labels, run_python

DAY_S = 86_400


@contextmanager
def nobody_may_write(*folders: Path) -> Iterator[None]:
    """Remove write permission from these folders, and the privileges of root."""
    for folder in folders:
        folder.chmod(0o555)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)
        for folder in folders:
            folder.chmod(0o755)


@pytest.fixture
def open_path(tmp_path: Path) -> Path:
    """Return a temporary folder that other users may enter."""
    for folder in (tmp_path, *tmp_path.parents):
        if folder == tmp_path or folder.name.startswith(("pytest-", "popen-")):
            folder.chmod(0o755)
    return tmp_path


def test_store_is_created_once_and_reopened(tmp_path):
    made = open_store(tmp_path / "deep" / "store")
    assert made.root == tmp_path / "deep" / "store"
    assert json.loads(made.layout.marker.read_text())["schema_version"] == 1
    assert open_store(str(made), create=False) == made


def test_relative_location_becomes_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert open_store("store").root == tmp_path / "store"
    assert open_store("~/store").root == tmp_path / "home" / "store"


@pytest.mark.parametrize("location", ["ftp://b", "file:///tmp/x", "az+x://y"])
@pytest.mark.parametrize("kind", [str, Path])
def test_url_is_refused_and_no_folder_is_created(location, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StoreError, match=r"local folders and in object stores only.*Give a folder"):
        open_store(kind(location))
    assert list(tmp_path.iterdir()) == []


def test_opening_without_create_makes_no_store(tmp_path):
    with pytest.raises(StoreError, match="it is missing"):
        open_store(tmp_path / "store", create=False)
    assert not (tmp_path / "store").exists()
    with pytest.raises(StoreError, match=r"no palpate-store\.json"):
        open_store(tmp_path, create=False)


def test_refuses_file_as_store(tmp_path):
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(StoreError, match="is a file"):
        open_store(file)
    with pytest.raises(StoreError, match="Cannot write"):
        open_store(file / "store")


def test_refuses_unwritable_place(open_path):
    with nobody_may_write(open_path):
        for place in (open_path / "store", open_path):
            with pytest.raises(StoreError, match=r"Permission denied.*choose another place"):
                open_store(place)


def test_read_only_store_can_be_read(open_path):
    store = open_store(open_path / "store")
    save_volume(store, "v", labels())
    with nobody_may_write(store.root, *store.layout.folders):
        readable = open_store(store.root, create=False)
        assert load_volume(readable, "v").values.shape == (5, 6, 7)
        with pytest.raises(StoreError, match="You cannot write to"):
            open_store(store.root)
        with pytest.raises(StoreError, match="Permission denied"):
            save_volume(readable, "w", labels())


def test_newer_store_requires_upgrade_and_is_unchanged(tmp_path):
    text = '{"schema_version": 2, "sharded": true}'
    (tmp_path / "palpate-store.json").write_text(text)
    for create in (True, False):
        with pytest.raises(NewerSchemaError, match=r"schema 2.*Upgrade"):
            open_store(tmp_path, create=create)
    assert [p.name for p in tmp_path.iterdir()] == ["palpate-store.json"]
    assert (tmp_path / "palpate-store.json").read_text() == text


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"schema_version":"one"}', "\xff", "3"])
def test_damaged_marker_gives_advice(tmp_path, text):
    (tmp_path / "palpate-store.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(StoreError, match=r"damaged.*Remove that file"):
        open_store(tmp_path)
    (tmp_path / "palpate-store.json").unlink()
    open_store(tmp_path)


def test_leftovers_of_killed_writers_are_ignored_and_removed_after_a_day(tmp_path):
    store = open_store(tmp_path)
    save_volume(store, "kept", labels())
    old, young = (store.layout.volumes / f".tmp-{n}-abc-x.zarr" for n in (1, 2))
    for folder in (old, young):
        (folder / "values").mkdir(parents=True)
        (folder / "zarr.json").write_text("{}")
    old_file = store.layout.evaluations / ".tmp-3-abc-x.json"
    old_file.write_text("{")
    past = time.time() - DAY_S - 60
    for path in (old, old_file, store.layout.volume("kept")):
        os.utime(path, (past, past))

    assert list_volumes(store) == ["kept"]
    assert list_volumes(open_store(tmp_path)) == ["kept"]
    assert not old.exists()
    assert not old_file.exists()
    assert young.exists()


def test_many_processes_open_a_new_store_concurrently(tmp_path):
    code = """
import sys
from multiprocessing import get_context
from palpate.storage.store import open_store
if __name__ == "__main__":
    with get_context("fork").Pool(8) as pool:
        roots = pool.map(open_store, [sys.argv[1]] * 64)
    print(len(set(roots)))
"""
    ran = run_python(code, tmp_path / "store")
    assert ran.stdout == "1\n", ran.stderr
    names = {p.name for p in (tmp_path / "store").iterdir()}
    assert names == {"palpate-store.json", "volumes", "meshes", "fields", "evaluations"}


def test_files_have_permissions_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        store = open_store(tmp_path / "store")
    finally:
        os.umask(before)
    assert stat.S_IMODE(store.layout.marker.stat().st_mode) == 0o640


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", ".tmp-x", "a\n", "a" * 200])
def test_name_cannot_escape_its_folder(tmp_path, name):
    layout = StoreLayout(tmp_path)
    for place in (layout.volume, layout.mesh, layout.field, layout.evaluation):
        with pytest.raises(StoreError, match="is not a valid name"):
            place(name)


def test_study_files_have_fixed_names(tmp_path):
    layout = StudyLayout(tmp_path)
    names = [p.name for p in (layout.study, layout.journal, layout.report)]
    assert names == ["study.yaml", "journal.jsonl", "report.html"]

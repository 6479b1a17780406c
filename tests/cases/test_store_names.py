"""Removal of named images from a store, and protection of those used by studies."""

import json
from pathlib import Path

import numpy as np
import pytest

from palpate.service.cli import main
from palpate.service.results.results_from_journal import study_results
from palpate.storage.store import Store, open_store
from palpate.storage.stored_arrays import has_volume, named_volumes, save_volume
from palpate.storage.values import Volume
from tests.recovery.stand_ins import SPEC, Inline, run, small_spec


def save(store: Store, digest: str, name: str | None, label: int = 1) -> None:
    volume = Volume(np.full((3, 4, 5), label, np.uint8), (1.0, 1.0, 2.0), (0.0, 0.0, 0.0))
    meta = {"kind": "image"} | ({} if name is None else {"name": name, "file": "a.nrrd"})
    save_volume(store, digest, volume, meta=meta)


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    monkeypatch.chdir(tmp_path)
    return open_store(tmp_path / "runs" / "store")


def test_a_damaged_volume_does_not_hide_the_names_of_others(store: Store) -> None:
    save(store, "aaaa", "patient")
    save(store, "bbbb", "broken")
    description = store.layout.volume("bbbb") / "zarr.json"
    description.write_text(description.read_text().replace('"broken"', '"patient"'))
    assert named_volumes(store) == {"patient": ["aaaa"]}


def test_rm_removes_a_name_and_its_volume(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    save(store, "aaaa", "patient")
    save(store, "bbbb", "other")
    assert main(["store", "rm", "patient", "--json"]) == 0
    removed = json.loads(capsys.readouterr().out)["removed"]
    assert removed == [{"name": "patient", "volume": "aaaa", "studies": []}]
    assert named_volumes(store) == {"other": ["bbbb"]}
    assert not has_volume(store, "aaaa")


def test_rm_of_an_unknown_name_removes_nothing(
    store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    save(store, "aaaa", "patient")
    assert main(["store", "rm", "patient", "nobody"]) == 2
    assert "has no volume named nobody. Names in it: patient." in capsys.readouterr().err
    assert has_volume(store, "aaaa")


def test_rm_refuses_volumes_used_by_studies_unless_forced(
    store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    save(store, "aaaa", "patient")
    save(store, "bbbb", "other")
    folder = Path("runs/demo")
    text = SPEC.replace("{phantom: {preset: 445ml}}", "{volume: patient}")
    run(folder, Inline(), small_spec(text))
    assert main(["store", "rm", "other", "patient"]) == 2
    said = capsys.readouterr().err
    assert "Studies need these volumes: patient by runs/demo." in said
    assert "Nothing was removed" in said and "--force" in said
    assert named_volumes(store) == {"patient": ["aaaa"], "other": ["bbbb"]}
    assert main(["store", "rm", "patient", "--force"]) == 0
    assert "patient (aaaa) was removed" in capsys.readouterr().out
    assert not has_volume(store, "aaaa")
    assert study_results(folder).state == "stopped"  # it can still be read

"""`palpate store`: checks and repairs, garbage collection, moving studies."""

import json
import os
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.service.study.study_archive import export_study, import_study
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import StoreError
from palpate.storage.journal import Journal
from palpate.storage.json_digests import dumps, seal
from palpate.storage.store import Store, open_store, save_evaluation
from palpate.storage.stored_arrays import has_field, has_volume, save_field, save_volume
from palpate.storage.values import Volume
from tests.recovery.stand_ins import Inline, executions, run, told

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Provide a completed study with stored fields and bodies."""
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline())
    store = open_store(tmp_path / "runs" / "store")
    log = StudyLog.read(StudyLayout(folder).journal)
    for number, path in enumerate(sorted(store.layout.evaluations.iterdir())):
        save_field(store, path.stem, np.full((4, 3), number, dtype=np.float64))
    session = log.last_session
    assert session is not None
    for name in (session.prepared["volume"], session.target["target"]):
        save_volume(store, name, small_volume(1))
    return folder


def test_exchanged_entries_and_edited_journals_end_the_check(call: Call, study: Path) -> None:
    store = store_of(study)
    one, other = sorted(store.layout.fields.iterdir())[:2]
    aside = one.with_name("aside")
    for place, target in ((one, aside), (other, one), (aside, other)):
        place.rename(target)
    journal = StudyLayout(study).journal
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:5] + lines[6:]))
    code, out, err = call("store", "check")
    assert code == 2
    assert "all is well" not in out
    assert f"{one} is damaged: it was written as fields/{other.stem}, so entries of" in err
    assert f"{other} is damaged: it was written as fields/{one.stem}, so entries of" in err
    assert (
        "runs/demo/journal.jsonl, line 6: it does not follow the line before it: lines were removed"
        in err
    )


def test_check_counts_what_was_written_before_seals_covered_it(call: Call, study: Path) -> None:
    description = next(store_of(study).layout.fields.iterdir()) / "zarr.json"
    text = json.loads(description.read_text())
    del text["attributes"]["name"], text["attributes"]["name_checksum"]
    description.write_text(json.dumps(text))
    journal = StudyLayout(study).journal
    records = list(Journal.read(journal))
    journal.write_text("".join(seal(dumps(record)) + "\n" for record in records))
    code, out, _ = call("store", "check")
    assert code == 0
    assert f"{len(records)} lines of journals were written before chained seals" in out
    assert "1 entries were written before their names were sealed" in out
    found = json.loads(call("store", "check", "--json")[1])
    assert found["unchained_journal_lines"] == len(records)
    assert found["entries_without_sealed_names"] == 1


def small_volume(label: int) -> Volume:
    return Volume(np.full((3, 4, 5), label, np.uint8), (1.0, 1.0, 2.0), (0.0, 0.0, 0.0))


def store_of(folder: Path) -> Store:
    return open_store(folder.parent / "store")


def test_damage_is_reported_set_aside_and_recreated(call: Call, study: Path) -> None:
    store = store_of(study)
    assert call("store", "check")[0] == 0
    done = (ending[2] for ending in told(study).values() if ending[3] == "done")
    digests = list(dict.fromkeys(done))
    field = store.layout.field(digests[0])
    chunk = next(p for p in field.rglob("*") if p.is_file() and p.name != "zarr.json")
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    shutil.rmtree(store.layout.field(digests[1]))
    store.layout.evaluation(digests[2]).write_text("{")
    (store.layout.fields / ".tmp-1-abc-x.zarr").mkdir()

    code, out, err = call("store", "check")
    assert code == 2
    assert "1 half written" in out
    assert sum(line.startswith("damaged: ") for line in err.splitlines()) == 4
    for name in digests[:3]:
        assert name in err
    code, out, _ = call("store", "check", "--repair", "--json")
    assert code == 0
    found = json.loads(out)
    assert len(found["damaged"]) == 4
    assert len(list(Path(found["set_aside"], "evaluations").iterdir())) == 3
    # A record without its field is also set aside: all three are recomputed.
    before = len(executions(study))
    again = study.with_name("again")
    run(again, Inline())
    assert told(again) == told(study)
    assert set(executions(study)[before:]) == set(digests[:3])


def test_garbage_excludes_needed_and_recent_data(call: Call, study: Path) -> None:
    store = store_of(study)
    old = {
        "unneeded": store.layout.volume("unneeded"),
        "imported": store.layout.volume("imported"),
        "part": store.layout.field("part"),
    }
    save_volume(store, "unneeded", small_volume(2))
    save_volume(store, "imported", small_volume(2), meta={"kind": "image", "name": "mine"})
    save_field(store, "part", np.zeros((2, 3)))
    save_evaluation(store, "gone", {"digest": "gone", "status": "diverged"})
    save_field(store, "young", np.zeros((2, 3)))
    needed = [store.layout.field(ending[2]) for ending in told(study).values()]
    for path in [*old.values(), store.layout.evaluation("gone"), *needed]:
        os.utime(path, (1e9, 1e9))

    code, out, _ = call("store", "gc", "--json")
    assert code == 0
    wanted = {"unneeded.zarr", "part.zarr", "gone.json"}
    assert {Path(path).name for path in json.loads(out)["entries"]} == wanted
    assert old["unneeded"].exists()  # nothing is removed without --delete
    assert call("store", "gc", "--delete")[0] == 0
    assert not has_volume(store, "unneeded")
    assert has_volume(store, "imported")
    assert has_field(store, "young")
    assert all(has_field(store, ending[2]) for ending in told(study).values())
    assert call("store", "gc", "--images", "--delete")[0] == 0
    assert not has_volume(store, "imported")
    code, _, err = call("store", "gc", "--studies", "nowhere")
    assert (code, "There is no study in nowhere" in err) == (2, True)


def test_exported_study_continues_elsewhere(
    call: Call, study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, _ = call("store", "export", "demo", "--out", "demo.tar")
    assert code == 0
    assert "palpate store import demo.tar" in out
    endings = told(study)
    ran = executions(study)
    shutil.rmtree(tmp_path / "runs")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert call("store", "import", tmp_path / "demo.tar")[0] == 0
    moved = elsewhere / "runs" / "demo"
    assert told(moved) == endings
    assert call("status", "demo")[0] == 0
    assert call("store", "check")[0] == 0
    assert json.loads(call("status", "demo", "--json")[1])["store"] == str(moved.parent / "store")
    again = moved.with_name("again")
    run(again, Inline())  # the evaluations are in the archive: none is recomputed
    assert not set(executions(again)) & {ending[2] for ending in endings.values()}
    assert told(again) == endings
    assert len(ran) > 0
    code, _, err = call("store", "import", tmp_path / "demo.tar")
    assert (code, "choose another place" in err) == (2, True)


@pytest.mark.parametrize(
    "name", ["../evil", "/tmp/evil", "study/../../evil", "store/volumes/../../evil", "study/x.py"]
)
def test_rejects_archive_with_outside_paths(study: Path, tmp_path: Path, name: str) -> None:
    archive = tmp_path / "demo.tar"
    export_study(study, archive)
    with tarfile.open(archive, "a") as tar:
        tar.add(study / "study.yaml", name, filter=lambda member: _renamed(member, name))
    with pytest.raises(StoreError, match="does not belong in it"):
        import_study(archive, tmp_path / "new" / "demo", tmp_path / "new" / "store")
    assert not (tmp_path / "new" / "demo").exists()
    assert not [p for p in (tmp_path / "new" / "store").iterdir() if p.name.startswith(".tmp")]


def _renamed(member: tarfile.TarInfo, name: str) -> tarfile.TarInfo:
    member.name = name
    return member


@pytest.mark.parametrize("damage", ["flip", "cut", "link", "no tar", "no manifest"])
def test_rejects_damaged_archive(study: Path, tmp_path: Path, damage: str) -> None:
    archive = tmp_path / "demo.tar"
    export_study(study, archive)
    data = archive.read_bytes()
    if damage == "flip":
        place = data.rindex(b'"candidate":')
        archive.write_bytes(data[:place] + data[place:].replace(b"candidate", b"candidat3", 1))
    elif damage == "cut":
        archive.write_bytes(data[: len(data) // 2])
    elif damage == "no tar":
        archive.write_bytes(b"x" * 2000)
    elif damage == "no manifest":
        with tarfile.open(archive, "w") as tar:
            tar.add(study / "study.yaml", "study/study.yaml")
    else:
        with tarfile.open(archive, "a") as tar:
            link = tarfile.TarInfo("store/evaluations/a.json")
            link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
            tar.addfile(link)
    with pytest.raises(StoreError, match="is not an archive of a study, or is damaged"):
        import_study(archive, tmp_path / "new" / "demo", tmp_path / "new" / "store")
    assert not (tmp_path / "new" / "demo").exists()

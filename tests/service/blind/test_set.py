"""Making and sealing of sets, and detection of changes."""

import hashlib
import json
import shutil
import subprocess
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from palpate.service.blind.sealed_diagnosis import differences, frozen
from palpate.service.blind.sealed_set import (
    BlindSet,
    Truths,
    check_cases,
    check_truths,
    file_hash,
    folder_hash,
    read_json,
    read_manifest,
    salted_hash,
    write_json,
)
from palpate.service.blind.set_making import SetRequest, plan, publish, shared_out, unmade
from palpate.service.errors_and_interrupts import TaskError
from palpate.storage.errors import InputError
from palpate.storage.json_digests import digest, to_json
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS
from tests.service.blind.blind_at_hand import Inline, make_set

SHARES = {"control": 2.0, "tilt": 1.0, "friction": 1.0}


def tiny(
    seed: int, kind: str, one_direction: bool, world: str, case: str, truth: str
) -> dict[str, Any]:
    """Make a case of two small files."""

    def write(case: Path, truth: Path) -> None:
        (case / "case.yaml").write_text(f"name: {case.name}\n")
        (case / "scan.nrrd").write_bytes(seed.to_bytes(8, "big"))
        (truth / "truth.json").write_text(json.dumps({"kind": kind, "causes": []}))

    publish(Path(case), Path(truth), write)
    return {"seconds": 0.0}


@pytest.fixture
def blind(tmp_path: Path) -> BlindSet:
    return make_set(tmp_path / "set", 8, tiny, shares=SHARES)


@pytest.fixture
def truths(blind: BlindSet) -> Truths:
    return Truths(blind.truth_beside())


def test_hashes_match_sha256sum(blind: BlindSet) -> None:
    case = next(blind.cases.iterdir())
    shell = "LC_ALL=C; export LC_ALL; sha256sum * | sha256sum"
    said = subprocess.run(shell, shell=True, cwd=case, capture_output=True, text=True, check=True)
    assert said.stdout.split()[0] == folder_hash(case)
    assert read_manifest(blind)["cases"][case.name]["case"] == folder_hash(case)


def test_a_truth_is_sealed_with_its_salt(blind: BlindSet, truths: Truths) -> None:
    entry = read_json(truths.plan)["cases"][3]
    content = folder_hash(truths.of(entry["id"])).encode()
    salted = hashlib.sha256(bytes.fromhex(entry["salt"]) + content).hexdigest()
    assert len(bytes.fromhex(entry["salt"])) == 32
    assert read_manifest(blind)["cases"][entry["id"]]["truth"] == salted
    assert salted_hash("00" * 32, truths.of(entry["id"])) != salted


def test_set_does_not_reveal_the_kinds_of_its_cases(blind: BlindSet, truths: Truths) -> None:
    entries = read_json(truths.plan)["cases"]
    assert Counter(e["kind"] for e in entries) == {"control": 4, "tilt": 2, "friction": 2}
    assert [e["id"] for e in entries] == sorted(e["id"] for e in entries)
    shown = "".join(p.read_bytes().decode("latin-1") for p in blind.root.rglob("*") if p.is_file())
    listed = [e["name"] for e in read_manifest(blind)["diagnosis"]["settings"]["effects"]]
    assert listed == [e.name for e in BREAST_EFFECTS]  # which are not kinds of cases
    for entry in entries:
        assert entry["salt"] not in shown
        assert str(entry["seed"]) not in shown
    assert "control" not in shown
    assert {p.stat().st_mtime for p in blind.cases.rglob("*.*")} == {0.0}
    assert not list(blind.root.rglob("truth*")) + list(blind.root.rglob(".tmp-*"))


def test_equal_seeds_draw_equal_cases_under_other_names(tmp_path: Path) -> None:
    sets = [make_set(tmp_path / name, 6, tiny, shares=SHARES) for name in "ab"]
    a, b = (read_json(Truths(s.truth_beside()).plan)["cases"] for s in sets)
    assert sorted((e["seed"], e["kind"]) for e in a) == sorted((e["seed"], e["kind"]) for e in b)
    assert {e["id"] for e in a}.isdisjoint(e["id"] for e in b)
    assert len({e["seed"] for e in a}) == 6


def test_existing_cases_are_not_made_again(blind: BlindSet, truths: Truths) -> None:
    sealed = file_hash(blind.manifest)
    again = SetRequest(8, None, False, 600)
    entries = plan(blind, truths, again, SHARES)
    assert unmade(blind, truths, entries) == []
    blind.manifest.unlink()
    lost, *kept = entries
    shutil.rmtree(blind.case(lost["id"]))
    stamps = {e["id"]: blind.case(e["id"]).stat().st_ctime_ns for e in kept}
    assert unmade(blind, truths, entries) == [lost]
    make_set(blind.root, 8, tiny, shares=SHARES)
    assert {e["id"]: blind.case(e["id"]).stat().st_ctime_ns for e in kept} == stamps
    assert file_hash(blind.manifest) == sealed


def test_rejects_another_set_in_the_same_folder(blind: BlindSet, truths: Truths) -> None:
    for asked in (
        SetRequest(9, 7, False, 600),
        SetRequest(8, 8, False, 600),
        SetRequest(8, 7, True, 600),
        SetRequest(8, 7, False, 600, True),
        SetRequest(8, 7, False, 600, world="hard"),
    ):
        with pytest.raises(InputError, match="plans another set"):
            plan(blind, truths, asked, SHARES)
    with pytest.raises(InputError, match="is sealed, and its truths are not in"):
        plan(blind, Truths(truths.root / "elsewhere"), SetRequest(8, 7, False, 600), SHARES)


def test_failed_case_leaves_no_files(tmp_path: Path) -> None:
    def failing(*asked: Any) -> dict[str, Any]:
        case, truth = asked[-2:]
        publish(Path(case), Path(truth), lambda c, t: (c / "half").write_text(str(1 / 0)))
        raise AssertionError

    with pytest.raises(TaskError, match=r"could not be made: ZeroDivisionError"):
        make_set(tmp_path / "set", 2, failing)
    assert not list(tmp_path.rglob("half"))
    assert not BlindSet(tmp_path / "set").manifest.exists()
    assert read_manifest(make_set(tmp_path / "set", 2, tiny))["cases"].keys() == {
        p.name for p in (tmp_path / "set" / "cases").iterdir()
    }


def test_names_changed_cases(blind: BlindSet) -> None:
    manifest = read_manifest(blind)
    check_cases(blind, manifest)
    first, second, third, *_ = sorted(manifest["cases"])
    (blind.case(first) / "scan.nrrd").write_bytes(b"other")
    shutil.rmtree(blind.case(second))
    shutil.copytree(blind.case(third), blind.case("new"))
    with pytest.raises(InputError) as said:
        check_cases(blind, manifest)
    assert f"missing: {second}; added: new; changed: {first}" in str(said.value)


def test_names_changed_truths_and_salts(blind: BlindSet, truths: Truths) -> None:
    manifest = read_manifest(blind)
    check_truths(truths, manifest)
    first, second, *_ = sorted(manifest["cases"])
    truth = truths.of(first) / "truth.json"
    truth.write_text(truth.read_text().replace("causes", "reasons"))
    found = read_json(truths.plan)
    next(e for e in found["cases"] if e["id"] == second)["salt"] = "00" * 32
    write_json(truths.plan, found)
    with pytest.raises(InputError, match=f"the sealed truth of {first}, {second}. Give"):
        check_truths(truths, manifest)


def test_shares_are_rounded_to_whole_numbers() -> None:
    shares = {"a": 0.18, "b": 0.12, "c": 0.05, "d": 0.65}
    assert Counter(shared_out(shares, 60)) == {"a": 11, "b": 7, "c": 3, "d": 39}
    assert len(shared_out(shares, 7)) == 7
    assert Counter(shared_out(shares, 1)) == {"d": 1}


def test_lists_changes_since_the_seal(monkeypatch: pytest.MonkeyPatch) -> None:
    sealed = to_json(frozen(5000))
    assert differences(sealed, frozen(5000)) == []
    assert differences(sealed, frozen(6000)) == ["mesh"]
    assert differences(sealed | {"code": "other"}, frozen(5000)) == ["code"]
    assert sealed["settings"]["effects"][0]["prior_sd"]
    louder = replace(SETTINGS, pose=replace(SETTINGS.pose, shift_sd_mm=5.0))
    monkeypatch.setattr("palpate.service.blind.sealed_diagnosis.SETTINGS", louder)
    assert differences(sealed, frozen(5000)) == ["pose"]


def test_seal_includes_every_setting() -> None:
    sealed = frozen(SETTINGS.mesh.nodes)
    held = {name: sealed.settings[name] for name in asdict(SETTINGS)}
    assert held == asdict(SETTINGS)
    assert sealed.settings_digest == digest(sealed.settings)


def test_inline_dispatcher_runs_every_task() -> None:
    dispatcher = Inline()
    endings = list(dispatcher.run(divmod, [("a", (7, 2)), ("b", (1, 0))]))
    assert [(e.key, e.value) for e in endings] == [("a", (3, 1)), ("b", None)]

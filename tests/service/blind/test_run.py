"""A set from its creation to its page, on small bodies from our own solver; and invalid use."""

import json
import shutil
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from palpate.service.blind.case_truth import CaseRecord
from palpate.service.blind.sealed_set import BlindSet, Truths, check_answers, file_hash, read_json
from palpate.service.blind.set_answering import (
    Answering,
    along_y,
    answer,
    request_of,
    seal,
    unanswered,
)
from palpate.service.blind.set_scoring import read_records, score_record, score_sets
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.diagnosis.diagnosis_run import finished, request_for
from palpate.storage.errors import InputError
from palpate.storage.json_digests import to_json, to_plain
from tests.service.blind.blind_at_hand import (
    NODES,
    SPACING_MM,
    SUSPECTS,
    TILT_DEG,
    Inline,
    make_set,
)
from tests.service.diagnosis.compressed_breast import read_settings


@pytest.fixture(scope="module", autouse=True)
def few_suspects() -> Any:
    """Use widely spaced points and two effects."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.service.blind.set_answering.request_for", small_request)
        yield


def small_request(path: Path, store: Path, nodes: int) -> Any:
    return request_for(path, store, nodes, SPACING_MM, SUSPECTS)


def run(asked: Answering, threads: int = 1) -> Inline:
    dispatcher = Inline(threads)
    answer(asked, unanswered(asked), cast(Dispatcher, dispatcher), lambda failed: None)
    return dispatcher


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> BlindSet:
    return make_set(tmp_path_factory.mktemp("blind") / "set")


@pytest.fixture(scope="module")
def answered(blind: BlindSet, tmp_path_factory: pytest.TempPathFactory) -> Answering:
    """A set with all cases diagnosed and sealed."""
    asked = Answering(blind, tmp_path_factory.mktemp("blind") / "store", "all", NODES)
    assert run(asked).asked == ["diagnose_alone"] * 2
    assert seal(asked) == file_hash(blind.sealed_answers("all"))
    return asked


@pytest.fixture(scope="module")
def records(answered: Answering) -> dict[str, CaseRecord]:
    """Records by kind."""
    blind = answered.blind
    names = sorted(p.name for p in blind.cases.iterdir())
    read = read_records(blind, Truths(blind.truth_beside()), names, "all")
    return {r.kind: r for r in read}


def test_finds_the_tilt_and_its_true_gap(records: dict[str, CaseRecord]) -> None:
    tilted = records["tilt"]
    assert (tilted.answer, tilted.primary) == ("effect", ("plate_tilt",))
    assert tilted.right
    depth = next(m for m in tilted.magnitudes if m.name == "tilt_depth_deg")
    assert (depth.true, depth.found) == (TILT_DEG, pytest.approx(TILT_DEG, rel=0.15))
    assert tilted.named_by == {"raw_correlation": "plate_tilt", "refit": "plate_tilt"}
    before, after = tilted.true_before_mm, tilted.true_after_mm
    assert before is not None
    assert after is not None
    # Without noise and on the same mesh, the right effect leaves only the voxel error.
    assert after < 0.15
    assert before > 3 * after
    assert tilted.claimed_before_mm == pytest.approx(before, rel=0.25)
    assert tilted.true_share == pytest.approx(tilted.claimed_share, abs=0.15)


def test_control_has_a_negligible_true_gap(records: dict[str, CaseRecord]) -> None:
    control = records["control"]
    assert control.group == "control"
    assert control.true_before_mm is not None
    assert control.true_before_mm < 0.12
    assert control.true_after_mm is None or control.answer != "no-gap"


def test_answer_matches_the_store(answered: Answering) -> None:
    blind = answered.blind
    for case in blind.cases.iterdir():
        found = finished(request_of(answered, case.name))
        assert found is not None
        said = read_json(blind.answer(case.name, "all"))
        assert said["summary"] == json.loads(json.dumps(to_plain(to_json(found.summary))))
        with np.load(blind.points(case.name, "all")) as kept:
            for key in ("points", "moved_before", "normals_before"):
                np.testing.assert_array_equal(kept[key], found.maps[key])
        assert set(said["baselines"]["raw_correlation"]) == set(SUSPECTS)


def test_answered_set_is_not_answered_again(answered: Answering) -> None:
    assert unanswered(answered) == []
    stamp = answered.blind.sealed_answers("all").stat().st_mtime_ns
    assert seal(answered) == file_hash(answered.blind.sealed_answers("all"))
    assert answered.blind.sealed_answers("all").stat().st_mtime_ns == stamp


def test_many_workers_share_the_last_cases(
    answered: Answering, blind: BlindSet, tmp_path: Path
) -> None:
    copy = BlindSet(shutil.copytree(blind.root, tmp_path / "set"))
    shutil.rmtree(copy.answers("all"))
    copy.sealed_answers("all").unlink()
    asked = Answering(copy, answered.store, "all", NODES, limit=1)
    assert "weigh_hypotheses" in run(asked, threads=8).asked
    assert len(unanswered(asked)) == 1
    assert seal(asked) is None
    assert "diagnose_alone" in run(asked, threads=1).asked
    assert seal(asked) == answered_alike(copy, blind)


def answered_alike(one: BlindSet, other: BlindSet) -> str:
    """Return the seal of `one`, whose answers are bit-identical to those of `other`."""
    hashes = [check_answers(s, "all")["answers"] for s in (one, other)]
    assert hashes[0] == hashes[1]
    return file_hash(one.sealed_answers("all"))


def test_score_includes_the_seals(answered: Answering) -> None:
    blind = answered.blind
    scored = score_sets([(blind, Truths(blind.truth_beside()))], "all")
    told = json.loads(json.dumps(score_record(scored)))
    assert told["seals"][0]["manifest"] == file_hash(blind.manifest)
    assert told["seals"][0]["declared"] is None
    assert sum(map(sum, told["confusion"]["counts"])) == 2
    by_key = {f["key"]: f for f in told["figures"]}
    assert by_key["first_visible"]["estimate"]["value"] == 1.0
    assert by_key["first_visible"]["met"] is True
    assert sum(band["named"]["count"] for band in told["reliability"]) == 1
    assert told["reliability"][2]["named"]["value"] == 1.0  # the tilt gains more than 50 nats
    (tilt,) = (case for case in told["cases"] if case["kind"] == "tilt")
    assert tilt["family_of"] == {"plate_tilt": "plate geometry"}
    assert tilt["gain"] > 50


@pytest.fixture
def copy(answered: Answering, tmp_path: Path) -> BlindSet:
    """A copy of the set with its answers and truths, for tests that change it."""
    blind = answered.blind
    shutil.copytree(blind.truth_beside(), tmp_path / "set-truth")
    return BlindSet(shutil.copytree(blind.root, tmp_path / "set"))


@pytest.mark.slow
def test_diagnosis_can_be_limited_to_scans_along_y(
    answered: Answering, copy: BlindSet, tmp_path: Path
) -> None:
    asked = Answering(copy, answered.store, "y", NODES)
    name = unanswered(asked)[0]
    folder = along_y(copy.case(name), tmp_path / name)
    shown = read_settings(folder)
    assert [d["volume"] for d in shown["scans"]["loads"]] == ["pressed_20N.nrrd"]
    assert not (folder / "pressed_8N_x.nrrd").exists()
    before = file_hash(copy.sealed_answers("all"))
    run(asked)
    assert seal(asked) == file_hash(copy.sealed_answers("y"))
    assert file_hash(copy.sealed_answers("all")) == before
    scored = score_sets([(copy, Truths(copy.truth_beside()))], "y")
    assert all(r.true_before_mm is not None for r in scored.records)
    assert scored.seals[0]["directions"] == "y"


def test_two_sets_are_scored_as_one(answered: Answering, copy: BlindSet) -> None:
    both = [(blind, Truths(blind.truth_beside())) for blind in (answered.blind, copy)]
    alone, together = (score_sets(sets, "all") for sets in (both[:1], both))
    assert len(together.records) == 2 * len(alone.records)
    assert together.name == f"{answered.blind.root.name} + {copy.root.name}"
    assert [one["set"] for one in together.seals] == [answered.blind.root.name, copy.root.name]
    counts = [f.estimate.count for f in together.metrics]
    assert counts == [2 * f.estimate.count for f in alone.metrics]


# Refusals


def test_rejects_a_changed_case(copy: BlindSet, tmp_path: Path) -> None:
    case = next(copy.cases.iterdir())
    (case / "note.txt").write_text("the plate is tilted")
    with pytest.raises(InputError, match=f"changed: {case.name}"):
        unanswered(Answering(copy, tmp_path, "all", NODES))


def test_changed_diagnosis_must_be_declared(copy: BlindSet, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sealed for: mesh changed\. .* --declare"):
        unanswered(Answering(copy, tmp_path, "all", NODES + 1))
    asked = Answering(copy, tmp_path, "all", NODES + 1, declared="a finer mesh")
    assert unanswered(asked) == []
    copy.sealed_answers("all").unlink()
    seal(asked)
    scored = score_sets([(copy, Truths(copy.truth_beside()))], "all")
    assert scored.seals[0]["declared"] == "a finer mesh"


def test_rejects_answers_from_two_versions(copy: BlindSet, tmp_path: Path) -> None:
    path = next(copy.answers("all").glob("*.json"))
    path.write_text(json.dumps(read_json(path) | {"code": "older"}))
    with pytest.raises(InputError, match=f"answers from other code: {path.stem}"):
        unanswered(Answering(copy, tmp_path, "all", NODES))


def test_rejects_scoring_of_incomplete_or_changed_sets(copy: BlindSet) -> None:
    truths = Truths(copy.truth_beside())
    score_sets([(copy, truths)], "all")
    with pytest.raises(InputError, match="not all cases are answered"):
        score_sets([(copy, truths)], "y")
    path = next(copy.answers("all").glob("*.json"))
    before = path.read_text()
    path.write_text(before.replace('"id"', '"ID"'))
    with pytest.raises(InputError, match=f"changed since they were sealed .*: {path.stem}"):
        score_sets([(copy, truths)], "all")
    path.write_text(before)
    truth = truths.of(path.stem) / "truth.json"
    truth.write_text(truth.read_text() + " ")
    with pytest.raises(InputError, match="does not have the sealed truth"):
        score_sets([(copy, truths)], "all")


def test_answers_with_probabilities_must_be_given_again(copy: BlindSet) -> None:
    def with_probabilities(path: Path) -> None:
        read = read_json(path)
        for key in ("rivals", "gain", "left_gain", "something_else"):
            del read["summary"][key]
        read["summary"] |= {"set90": ["plate_tilt"], "no_gap_probability": 0.01}
        path.write_text(json.dumps(read))

    for path in copy.answers("all").glob("*.json"):
        with_probabilities(path)
    names = sorted(p.name for p in copy.cases.iterdir())
    said = rf"such as one that states probabilities .*`palpate blind run {copy.root} "
    with pytest.raises(InputError, match=said):
        read_records(copy, Truths(copy.truth_beside()), names, "all")


def test_failed_diagnosis_is_recorded_with_its_reason(
    copy: BlindSet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refusing(path: Path, *more: Any) -> Any:
        if path.name == broken:
            raise InputError("the scan is empty")
        return small_request(path, *more)

    def crashing(request: Any) -> Any:
        raise ZeroDivisionError("no such tissue")

    broken, other = sorted(p.name for p in copy.cases.iterdir())
    shutil.rmtree(copy.answers("all"))
    copy.sealed_answers("all").unlink()
    monkeypatch.setattr("palpate.service.blind.set_answering.request_for", refusing)
    monkeypatch.setattr("palpate.service.blind.set_answering.diagnose_alone", crashing)
    asked = Answering(copy, tmp_path / "store", "all", NODES)
    told: list[str] = []
    answer(asked, unanswered(asked), cast(Dispatcher, Inline()), told.append)
    assert sorted(told) == ["InputError: the scan is empty", "ZeroDivisionError: no such tissue"]
    assert read_json(copy.answer(other, "all"))["failed"] == "ZeroDivisionError: no such tissue"
    seal(asked)
    scored = score_sets([(copy, Truths(copy.truth_beside()))], "all")
    assert {r.answer for r in scored.records} == {"failed"}
    assert {r.reason for r in scored.records} == set(told)
    assert not any(r.right for r in scored.records)

"""The tasks as a worker runs them, on a small breast and a real store."""

import json
import math

import numpy as np
import pytest

from palpate.storage.backends.atomic_files import withdraw
from palpate.storage.errors import InputError, StoreError
from palpate.storage.store import load_evaluation, open_store
from palpate.storage.stored_arrays import (
    has_volume,
    load_field,
    load_volume,
    save_volume,
    volume_meta,
)
from palpate.storage.values import Tissue, Volume
from palpate.workers.organs.breast.breast_organ import ORGAN, Breast, on_lattice
from palpate.workers.resources import CACHE
from palpate.workers.tasks import study_tasks as tasks
from palpate.workers.tasks.task_store import BodyStore

CASE = {
    "reference": {"phantom": {"preset": "250ml", "spacing_mm": 2.0}},
    "mesh": {"nodes": 1200},
    "load": {"force_n": 60},
}
HIDDEN = {"E_fat_kpa": 12, "E_glandular_kpa": 30}


class Study:
    def __init__(self, folder):
        self.store = str(folder / "store")
        self.house = open_store(self.store)
        self.prepared = tasks.prepare_case(CASE, self.store)
        self.made = tasks.make_target(CASE, {"constants": HIDDEN}, self.store)
        self.target = self.made["target"]

    def request(self, *, constants=None, **more):
        return {
            "store": self.store,
            "case": CASE,
            "prepared": self.prepared,
            "target": self.target,
            "constants": constants or {"E_fat": 0.014},
        } | more


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    CACHE.clear()
    return Study(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def evaluated(study):
    return tasks.evaluate(study.request())


def test_prepared_facts_describe_body_and_mesh(study):
    facts = study.prepared["facts"]
    assert facts["nodes"] == pytest.approx(1200, rel=0.1)
    assert facts["levels"][-1] == facts["nodes"]
    assert facts["volume_ml"] == pytest.approx(250, rel=0.02)
    assert facts["glandular_fraction"] == pytest.approx(0.2, abs=0.02)
    assert facts["body_y_mm"] == [-38.0, 38.0]
    assert facts["voxels"] * 0.008 == pytest.approx(facts["volume_ml"])


def test_preparing_again_reuses_stored_results(study, monkeypatch):
    monkeypatch.setattr(Breast, "make_body", None)
    monkeypatch.setattr(Breast, "make_mesh", None)
    assert tasks.prepare_case(CASE, study.store) == study.prepared


def test_stored_target_does_not_reveal_its_constants(study):
    meta = volume_meta(study.house, study.target)
    assert meta["constants"]["E_fat"] == 0.012
    assert meta["constants"]["E_glandular"] == 0.03
    assert meta["kind"] == "simulated"
    assert tasks.make_target(CASE, {"constants": HIDDEN}, study.store) == study.made


def test_removed_target_is_computed_again(study):
    withdraw(study.house.layout.volume(study.target))
    assert tasks.make_target(CASE, {"constants": HIDDEN}, study.store)["target"] == study.target
    assert has_volume(study.house, study.target)


def test_hidden_constants_score_minus_infinity(study):
    found = tasks.evaluate(study.request(constants={"E_fat": 0.012, "E_glandular": 0.03}))
    assert found["status"] == "done"
    assert found["score"]["gsf"] == -math.inf
    assert found["score"]["jc"] == 1.0


def test_evaluation_is_a_small_record(study, evaluated):
    assert evaluated["status"] == "done"
    assert evaluated["reason"] == ""
    assert not evaluated["reused"]
    assert 0 < evaluated["score"]["jc"] < 1
    assert evaluated["outcome"]["plate_force_n"] == pytest.approx(60, rel=1e-6)
    assert evaluated["constants"]["E_fat"] == 0.014
    assert set(evaluated["seconds"]) == {"load", "solve", "deform", "score"}
    assert len(json.dumps(evaluated)) < 5000


def test_field_and_record_are_stored_but_not_the_volume(study, evaluated):
    name = evaluated["digest"]
    assert load_field(study.house, name).shape == (study.prepared["facts"]["nodes"], 3)
    assert load_evaluation(study.house, name)["score"] == evaluated["score"]
    assert not has_volume(study.house, name)


def test_stored_evaluation_is_not_computed_again(study, evaluated, monkeypatch):
    monkeypatch.setattr(Breast, "solve", None)
    again = tasks.evaluate(study.request())
    assert again == evaluated | {"reused": True}


def test_volume_kept_later_is_the_scored_volume(study, evaluated):
    name = tasks.keep_volume(study.request())
    assert name == evaluated["digest"]
    one = tasks.score_bodies(CASE, study.store, study.target, name)
    assert set(one) == {"glandular", "fat", "skin", "ligament", "outline"}  # no muscle
    assert one["outline"]["jc"] > one["fat"]["jc"]
    assert one["glandular"] == evaluated["score"]
    assert one["fat"]["jc"] > one["glandular"]["jc"]
    kept = load_volume(study.house, name)
    withdraw(study.house.layout.volume(name))
    tasks.evaluate(study.request(keep_volume=True))
    np.testing.assert_array_equal(load_volume(study.house, name).values, kept.values)


def test_digest_depends_on_everything_that_changes_the_result(study):
    def name(case=CASE, target=study.target, constants=None, score=None, prepared=study.prepared):
        constants = constants or {"E_fat": 0.014}
        return tasks.evaluation_digest(case, prepared, target, constants, score)

    others = [
        name(case=CASE | {"load": {"force_n": 61}}),
        name(case=CASE | {"model": {"skin": "membrane"}}),
        name(case=CASE | {"constants": {"nu": 0.48}}),
        name(target="0" * 16),
        name(constants={"E_fat": 0.0140000001}),
        name(score={"labels": ["fat"]}),
        name(prepared=study.prepared | {"mesh": "0" * 16}),
    ]
    assert len({name(), *others}) == 8
    assert name() == name(case=CASE | {"organ": "breast"}, score={"labels": ["glandular"]})


def test_candidates_share_one_validated_case(study):
    assert tasks.case_of(study.request()["case"]) is tasks.case_of(json.loads(json.dumps(CASE)))
    assert tasks.case_of(CASE | {"load": {"force_n": 61}}).load.force_n == 61


def test_constants_count_in_case_and_request(study):
    by_case = tasks.evaluation_digest(
        CASE | {"constants": {"E_fat_kpa": 14}}, study.prepared, study.target, {}
    )
    assert by_case == tasks.evaluate(study.request())["digest"]


def test_worker_of_another_version_refuses_the_task(study):
    with pytest.raises(StoreError, match="different versions"):
        tasks.evaluate(study.request(digest="0" * 16))


def test_divergence_is_an_ordinary_result(study, monkeypatch):
    solve = Breast.solve

    def interrupted(*args):
        solution = solve(*args)
        outcome = type(solution.outcome)(
            **solution.outcome.as_dict() | {"converged": False, "reason": "no step descends"}
        )
        return type(solution)(solution.displacement_mm, outcome)

    monkeypatch.setattr(Breast, "solve", interrupted)
    request = study.request(constants={"E_fat": 0.019}, keep_volume=True)
    found = tasks.evaluate(request)
    assert (found["status"], found["reason"]) == ("diverged", "no step descends")
    assert found["score"] is None
    assert not has_volume(study.house, found["digest"])
    monkeypatch.undo()
    assert tasks.evaluate(request) == found | {"reused": True}


def test_refuses_target_that_diverges(study, monkeypatch):
    record = {"status": "diverged", "reason": "no step descends"}
    monkeypatch.setattr(tasks, "simulate_once", lambda *_: record)
    with pytest.raises(InputError, match="cannot be simulated: no step descends"):
        tasks.make_target(CASE, {"constants": HIDDEN}, study.store)


def test_undeformed_body_is_a_poor_match(study, evaluated):
    before = tasks.score_bodies(CASE, study.store, study.target, study.prepared["volume"])[
        "glandular"
    ]
    assert before["jc"] < evaluated["score"]["jc"]
    assert before["gsf"] > evaluated["score"]["gsf"]


def test_matches_target_with_other_voxels_and_another_mesh(study):
    fine = tasks.make_target(CASE, {"constants": HIDDEN, "mesh": {"nodes": 1600}}, study.store)[
        "target"
    ]
    assert fine != study.target
    moved = load_volume(study.house, fine)
    other = on_lattice(moved, Volume(moved.values, (1.6, 1.6, 1.6), (0.1, 0.2, 0.3)))
    target = BodyStore(study.house, ORGAN).add(other, {"kind": "simulated"})
    found = tasks.evaluate(study.request(target=target, constants={"E_fat": 0.012}))
    assert found["score"]["jc"] > 0.5
    assert (
        tasks.score_bodies(CASE, study.store, target, study.prepared["volume"])["glandular"]["jc"]
        < 0.5
    )


def block(tmp_path):
    values = np.zeros((30, 40, 50), np.uint8)
    values[:26, 4:36, 4:46] = 1
    values[5:20, 12:28, 12:36] = 2
    np.save(tmp_path / "scan.npy", values)
    return {
        "volume": str(tmp_path / "scan.npy"),
        "labels": {0: "air", 1: "fat", 2: "glandular"},
        "spacing_mm": 2.0,
    }


def test_image_is_read_once_and_named_after_its_content(tmp_path, monkeypatch):
    store = str(tmp_path / "store")
    case = {"reference": block(tmp_path), "mesh": {"nodes": 1200}}
    first = tasks.prepare_case(case, store)
    assert first["facts"]["tissue_ml"]["glandular"] == 15 * 16 * 24 * 0.008
    made = tasks.make_target(CASE, block(tmp_path), store)
    assert made == {"target": first["volume"], "kind": "image"}
    monkeypatch.setattr(Breast, "make_body", None)
    assert tasks.prepare_case(case, store) == first
    moved = tmp_path / "moved.npy"
    (tmp_path / "scan.npy").rename(moved)
    again = case | {"reference": case["reference"] | {"volume": str(moved)}}
    assert tasks.prepare_case(again, store)["volume"] == first["volume"]


def test_stored_volume_is_found_by_digest_and_by_name(tmp_path):
    house = open_store(tmp_path / "store")
    values = np.zeros((30, 40, 50), np.uint8)
    values[:26, 4:36, 4:46] = Tissue.FAT
    save_volume(house, "abc123", Volume(values, (2.0, 2.0, 2.0)), meta={"name": "patient-3"})
    for given in ("abc123", "patient-3"):
        made = tasks.make_target(CASE, {"volume": given}, str(house.root))
        assert made == {"target": "abc123", "kind": "image"}


def test_missing_volume_lists_the_searched_places(tmp_path):
    with pytest.raises(InputError, match=r"neither a file or folder .* nor a volume in the store"):
        tasks.make_target(CASE, {"volume": "nowhere"}, str(tmp_path / "store"))


def test_refuses_skin_that_the_mesh_cannot_resolve(study):
    case = CASE | {"model": {"skin": "layer"}}
    with pytest.raises(InputError, match=r"skin is .* mm thick, the elements are .*membrane"):
        tasks.prepare_case(case, study.store)


def test_plates_of_an_imaged_target_are_placed_at_the_target(study):
    """This also holds if the target is shifted."""
    case = CASE | {"load": {"plate_distance_mm": {"final": 44}}}
    made = tasks.make_target(case, {"constants": HIDDEN}, study.store)
    body = load_volume(study.house, made["target"])
    x, y, z = body.origin_mm
    shifted = Volume(body.values, body.spacing_mm, (x, y + 10, z))
    imaged = BodyStore(study.house, ORGAN).add(shifted, {"kind": "image"})
    request = study.request(
        case=case, target=imaged, constants={"E_fat": 0.012, "E_glandular": 0.03}
    )
    assert tasks.evaluate(request)["score"]["jc"] > 0.9

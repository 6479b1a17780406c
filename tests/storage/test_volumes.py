"""Volumes, meshes, fields and records are stored completely."""

import json
import math

import numpy as np
import pytest
import zarr

from palpate.storage.backends.atomic_files import withdraw
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.store import load_evaluation, open_store, save_evaluation
from palpate.storage.stored_arrays import (
    has_field,
    has_mesh,
    has_volume,
    list_volumes,
    load_field,
    load_mesh,
    load_volume,
    save_field,
    save_mesh,
    save_volume,
    volume_meta,
)
from palpate.storage.values import Volume
from tests.storage.stores_at_hand import labels, run_python, same_bits


@pytest.fixture
def store(tmp_path):
    return open_store(tmp_path / "store")


def test_voxels_spacing_and_origin_round_trip_bit_for_bit(store):
    volume = labels()
    save_volume(store, "v", volume)
    read = load_volume(store, "v")
    assert same_bits(read.values, volume.values)
    assert read.spacing_mm == volume.spacing_mm == (0.3, 0.5, 0.7)
    assert read.origin_mm == volume.origin_mm
    assert read.on_lattice_of(volume, tolerance=1e-15)


def test_frame_of_reference_and_unknown_place_are_kept(store):
    values = labels().values
    save_volume(store, "v", Volume(values, (1, 2, 3), frame_uid="1.2.840.1", place_known=False))
    read = load_volume(store, "v")
    assert read.frame_uid == "1.2.840.1"
    assert not read.place_known


def test_volume_stored_without_frame_has_known_place(store):
    save_volume(store, "v", labels())
    assert not {"frame_uid", "place_known"} & set(volume_meta(store, "v"))
    assert load_volume(store, "v").place_known


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.float32])
def test_compartments_and_grey_values_have_no_label_names(store, dtype):
    values = (np.arange(60).reshape(3, 4, 5) - 3).astype(dtype)
    save_volume(store, "v", Volume(values, (1, 2, 3)))
    assert same_bits(load_volume(store, "v").values, values)
    assert volume_meta(store, "v")["labels"] is None


def test_grey_bytes_are_not_tissues(store):
    save_volume(store, "v", Volume(np.full((1, 1, 1), 6, np.uint8), (1, 1, 1)))
    assert volume_meta(store, "v")["labels"] is None


def test_view_of_a_volume_is_stored_correctly(store):
    whole = np.random.default_rng(0).integers(0, 6, (20, 20, 20), dtype=np.uint8)
    view = whole[3:17:2, ::-1, 5:].transpose(2, 0, 1)
    save_volume(store, "v", Volume(view, (1, 1, 1)))
    read = load_volume(store, "v").values
    assert np.array_equal(read, view)
    assert read.flags.c_contiguous


def test_volume_with_several_chunks_along_every_axis_round_trips(store):
    values = np.random.default_rng(0).integers(0, 6, (130, 129, 257), dtype=np.uint8)
    save_volume(store, "v", Volume(values, (0.25, 0.25, 0.25)))
    assert same_bits(load_volume(store, "v").values, values)


def test_metadata_is_read_without_voxels(store):
    meta = {"kind": "phantom", "settings": {"seed": 1, "best": -math.inf}, "name": "inf"}
    save_volume(store, "v", labels(), meta=meta)
    for chunk in (store.layout.volume("v") / "values" / "c").rglob("0"):
        if chunk.is_file():
            chunk.unlink()
    known = volume_meta(store, "v")
    assert {key: known[key] for key in meta} == meta
    assert known["spacing_mm"] == [0.3, 0.5, 0.7]
    assert known["shape"] == [5, 6, 7]
    assert known["dtype"] == "uint8"
    assert known["labels"]["2"] == "glandular"


def test_spacing_and_labels_are_in_the_attributes(store):
    save_volume(store, "v", labels())
    attributes = zarr.open_group(store.layout.volume("v"), mode="r").attrs.asdict()["meta"]
    assert attributes["origin_mm"] == [-12.25, 0.1, 1e-3]
    assert attributes["labels"]["0"] == "air"


def test_metadata_cannot_contradict_the_volume(store):
    with pytest.raises(StoreError, match="'spacing_mm'"):
        save_volume(store, "v", labels(), meta={"spacing_mm": [1, 1, 1]})
    assert not has_volume(store, "v")


def test_volumes_are_listed_and_removed(store):
    for name in ("b", "a"):
        save_volume(store, name, labels())
    assert list_volumes(store) == ["a", "b"]
    assert withdraw(store.layout.volume("a"))
    assert not withdraw(store.layout.volume("a"))
    assert list_volumes(store) == ["b"]
    assert [p.name for p in store.layout.volumes.iterdir()] == ["b.zarr"]
    with pytest.raises(StoreError, match=r"a\.zarr is not in the store"):
        load_volume(store, "a")


def test_partially_removed_volume_is_gone(store):
    save_volume(store, "v", labels())
    code = """
import os, signal, sys
from palpate.storage.backends import atomic_files
from palpate.storage.store import open_store
atomic_files.discard = lambda path: os.kill(os.getpid(), signal.SIGKILL)
atomic_files.withdraw(open_store(sys.argv[1]).layout.volume("v"))
"""
    assert run_python(code, store.root).returncode == -9
    assert not has_volume(store, "v")
    assert list_volumes(store) == []


def test_mesh_round_trips_with_metadata(store):
    arrays = {"0.nodes": np.random.default_rng(0).random((4, 3)), "size": np.array(2.5)}
    facts = {"volume": "v", "facts": {"nodes": 4, "seconds": {"mesh": 0.5}}}
    assert not has_mesh(store, "m")
    save_mesh(store, "m", arrays, facts)
    read, meta = load_mesh(store, "m")
    assert has_mesh(store, "m")
    assert all(same_bits(read[name], arrays[name]) for name in arrays)
    assert meta == facts


def test_field_round_trips(store):
    field = np.random.default_rng(0).normal(size=(1000, 3))
    save_field(store, "f", field)
    assert has_field(store, "f")
    assert same_bits(load_field(store, "f"), field)


@pytest.mark.parametrize("bad", [np.zeros((4, 4)), np.zeros(3), np.zeros((4, 3), np.float32)])
def test_refuses_invalid_displacement(store, bad):
    with pytest.raises(
        StoreError, match=r"expected \(n, 3\), or \(n, 2\) for a section, and float64"
    ):
        save_field(store, "f", bad)
    assert not has_field(store, "f")


RECORD = {
    "digest": "e",
    "status": "done",
    "reason": "inf",
    "score": {"gsf": -math.inf, "mhd_mm": 0.0, "jc": 1.0},
    "outcome": {"newton_iterations": [3, 2], "residual_n": 1e-9, "converged": True},
    "seconds": {"solve": 0.1 + 0.2},
}


def test_evaluation_round_trips_with_infinities(store):
    assert load_evaluation(store, "e") is None
    save_evaluation(store, "e", RECORD)
    assert load_evaluation(store, "e") == RECORD


def test_evaluation_may_contain_numpy_numbers_tuples_and_nan(store):
    record = {"digest": "e", "score": {"gsf": np.float64("inf")}}
    record |= {"outcome": {"n": (np.int64(3),), "r": math.nan}}
    save_evaluation(store, "e", record)
    read = load_evaluation(store, "e")
    assert read["score"]["gsf"] == math.inf
    assert read["outcome"]["n"] == [3]
    assert math.isnan(read["outcome"]["r"])


def test_evaluations_are_standard_json(store):
    save_evaluation(store, "e", RECORD)

    def refuse(constant):
        raise AssertionError(constant)

    text = store.layout.evaluation("e").read_text()
    assert json.loads(text, parse_constant=refuse)["record"]["score"]["gsf"] == "-inf"


def test_evaluation_is_written_whole_or_not_at_all(store):
    code = """
import os, signal, sys
from pathlib import Path
from palpate.storage.store import save_evaluation
from palpate.storage.store import open_store
Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
save_evaluation(open_store(sys.argv[1]), "e", {"a": 1})
"""
    assert run_python(code, store.root).returncode == -9
    assert load_evaluation(store, "e") is None


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"schema_version":1}', '{"schema_version":1,"record":3}']
)
def test_damaged_evaluation_gives_advice(store, text):
    store.layout.evaluation("e").write_text(text)
    with pytest.raises(StoreError, match=r"damaged.*Remove that file"):
        load_evaluation(store, "e")


def test_newer_evaluation_requires_upgrade(store):
    store.layout.evaluation("e").write_text('{"schema_version":2,"record":{}}')
    with pytest.raises(NewerSchemaError, match="Upgrade"):
        load_evaluation(store, "e")

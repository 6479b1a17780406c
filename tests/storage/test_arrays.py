"""Arrays are read back bit for bit, whole or not at all."""

import errno
import json
import math
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from palpate.storage import stored_arrays as module
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.stored_arrays import has_arrays, load_arrays, load_meta, save_arrays
from tests.storage.stores_at_hand import run_python, same_bits

RNG = np.random.default_rng(1)
MANY = {
    "0.nodes": RNG.normal(size=(11, 3)),
    "0.tets": RNG.integers(0, 11, (7, 4), dtype=np.int32),
    "1.fractions": RNG.random((7, 6)).astype(np.float32),
    "wall": np.empty(0, np.int32),
    "no_rows": np.empty((0, 3)),
    "element_size_mm": np.array(6.5),
    "odd": np.array([-0.0, np.nan, np.inf, -np.inf, 5e-324]),
    "minus_zeros": np.full((4, 4, 4), -0.0),
    "mask": np.array([True, False]),
    "ids": np.array([0, 2**63], np.uint64),
    "complex": np.array([1 + 2j]),
}


def test_arrays_of_all_types_round_trip_bit_for_bit(tmp_path):
    meta = {"facts": {"nodes": 11, "gsf": -math.inf}, "word": "inf", "list": [1, 2.5, None]}
    save_arrays(tmp_path / "m.zarr", MANY, meta)
    arrays, read = load_arrays(tmp_path / "m.zarr")
    assert list(arrays) == list(MANY)
    assert all(same_bits(arrays[name], MANY[name]) for name in MANY)
    assert read == load_meta(tmp_path / "m.zarr") == meta
    assert all(a.flags.c_contiguous for a in arrays.values())


@given(
    hnp.arrays(
        st.sampled_from([np.uint8, np.int16, np.int64, np.float32, np.float64]),
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5),
    )
)
@settings(max_examples=25, deadline=None)
def test_any_array_round_trips(tmp_path_factory, array):
    path = tmp_path_factory.mktemp("any") / "a.zarr"
    save_arrays(path, {"a": array})
    assert same_bits(load_arrays(path)[0]["a"], array)


def test_memory_layout_and_byte_order_do_not_matter(tmp_path):
    base = RNG.normal(size=(6, 8, 10))
    views = {
        "fortran": np.asfortranarray(base),
        "strided": base[::2, ::-1, 1::3],
        "transposed": base.T,
        "read_only": np.broadcast_to(base[0], (3, 8, 10)),
    }
    save_arrays(tmp_path / "v.zarr", {**views, "big": base.astype(">f8")})
    arrays, _ = load_arrays(tmp_path / "v.zarr")
    assert all(same_bits(arrays[n], np.ascontiguousarray(v)) for n, v in views.items())
    assert same_bits(arrays["big"], base)


def test_only_requested_arrays_are_read(tmp_path):
    save_arrays(tmp_path / "m.zarr", MANY)
    shutil.rmtree(tmp_path / "m.zarr" / "0.tets")
    arrays, _ = load_arrays(tmp_path / "m.zarr", ["wall", "0.nodes"])
    assert list(arrays) == ["wall", "0.nodes"]
    with pytest.raises(StoreError, match="no array 'walls', only"):
        load_arrays(tmp_path / "m.zarr", ["walls"])


def test_file_is_plain_zarr_3_with_zstd(tmp_path):
    save_arrays(tmp_path / "v.zarr", {"values": np.zeros((130, 20, 129), np.uint8)})
    array = zarr.open_array(tmp_path / "v.zarr", path="values", mode="r")
    assert array.metadata.zarr_format == 3
    assert array.chunks == (128, 20, 128)
    assert [type(c).__name__ for c in array.compressors] == ["ZstdCodec"]
    assert array.metadata.dimension_names == ("z", "y", "x")
    files = [p for p in (tmp_path / "v.zarr").rglob("*") if p.is_file()]
    assert len(files) == 2 + 4  # two descriptions, 2 x 1 x 2 chunks


def test_long_arrays_are_chunked_along_their_first_axis(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "CHUNK_BYTES", 240)
    field = RNG.normal(size=(25, 3))
    save_arrays(tmp_path / "f.zarr", {"u": field})
    assert zarr.open_array(tmp_path / "f.zarr", path="u", mode="r").chunks == (10, 3)
    assert same_bits(load_arrays(tmp_path / "f.zarr")[0]["u"], field)


@pytest.mark.parametrize("name", ["", "a/b", ".x", "__x", "zarr.json"])
def test_bad_name_is_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(StoreError, match="cannot be the name of an array"):
        save_arrays(tmp_path / "x.zarr", {"good": np.zeros(1), name: np.zeros(1)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bad", [np.array(["a"]), np.array([{}], object), np.zeros(1, "M8[s]")])
def test_strings_and_objects_are_refused(tmp_path, bad):
    with pytest.raises(StoreError, match="expected numbers or booleans"):
        save_arrays(tmp_path / "x.zarr", {"a": bad})


def test_first_writer_of_a_name_wins(tmp_path):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.zeros(3)})
    save_arrays(path, {"a": np.ones(3)})
    assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]


def test_writer_that_finishes_second_discards_its_result(tmp_path, monkeypatch):
    path = tmp_path / "x.zarr"
    rename = os.rename

    def slow(source: Path, target: Path) -> None:
        monkeypatch.setattr("palpate.storage.backends.atomic_files.os.rename", rename)
        save_arrays(path, {"a": np.zeros(3)})  # the other writer finishes first
        rename(source, target)

    monkeypatch.setattr("palpate.storage.backends.atomic_files.os.rename", slow)
    save_arrays(path, {"a": np.ones(3)})
    assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]
    assert [p.name for p in tmp_path.iterdir()] == ["x.zarr"]


def test_group_published_meanwhile_is_never_removed(tmp_path, monkeypatch):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.zeros(3)})
    monkeypatch.setattr(
        "palpate.storage.stored_arrays.has_arrays", lambda _: False
    )  # checked before it exists
    create = zarr.create_group

    def while_it_is_filled(*arguments: object, **options: object) -> zarr.Group:
        assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]
        return create(*arguments, **options)

    monkeypatch.setattr(
        "palpate.storage.backends.folder_backend.zarr.create_group", while_it_is_filled
    )
    save_arrays(path, {"a": np.ones(3)})
    assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]


def test_concurrent_writers_of_one_name_leave_one_whole_group(tmp_path):
    code = """
import sys
from pathlib import Path
import numpy as np
from palpate.storage.stored_arrays import load_arrays, save_arrays
path = Path(sys.argv[1])
for n in range(20):
    save_arrays(path / f"{n}.zarr", {"a": np.full((40, 40, 40), int(sys.argv[2]))})
    a = load_arrays(path / f"{n}.zarr")[0]["a"]
    assert (a == a[0, 0, 0]).all()
"""
    with ThreadPoolExecutor(3) as pool:
        ran = list(pool.map(lambda n: run_python(code, tmp_path, str(n)), range(3)))
    assert [r.returncode for r in ran] == [0, 0, 0], ran[0].stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(f"{n}.zarr" for n in range(20))


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from palpate.storage.backends import atomic_files
from palpate.storage.stored_arrays import save_arrays

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

setattr(atomic_files.os if sys.argv[2] == "rename" else atomic_files, sys.argv[2], die)
save_arrays(Path(sys.argv[1]), {"a": np.ones((200, 200, 3))}, {})
"""


@pytest.mark.parametrize("moment", ["rename", "sync"])
def test_writer_killed_before_the_rename_leaves_nothing_readable(tmp_path, moment):
    path = tmp_path / "x.zarr"
    assert run_python(KILLED, path, moment).returncode == -9
    (leftover,) = tmp_path.iterdir()
    assert leftover.name.startswith(".tmp-")
    assert not has_arrays(path)
    with pytest.raises(StoreError, match=r"not in the store.*Run the study again"):
        load_arrays(path)
    save_arrays(path, {"a": np.zeros(3)})
    assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]


def test_full_disk_raises_store_error_and_leaves_nothing(tmp_path):
    code = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from palpate.storage.stored_arrays import save_arrays
from palpate.storage.errors import StoreError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    save_arrays(Path(sys.argv[1]), {"a": np.random.default_rng(0).normal(size=10_000)})
except StoreError as error:
    print(error)
"""
    ran = run_python(code, tmp_path / "x.zarr")
    assert "Cannot write" in ran.stdout, ran.stderr
    assert "File too large" in ran.stdout
    assert list(tmp_path.iterdir()) == []


def test_no_space_left_gives_advice(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("palpate.storage.backends.atomic_files.sync", full)
    with pytest.raises(StoreError, match=r"No space left.*free some space"):
        save_arrays(tmp_path / "x.zarr", {"a": np.zeros(3)})
    assert list(tmp_path.iterdir()) == []


def chunk_of(path: Path) -> Path:
    return next(p for p in (path / "a" / "c").rglob("*") if p.is_file())


def test_detects_lost_chunk(tmp_path):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.ones((130, 2, 2))})
    chunk_of(path).unlink()
    with pytest.raises(StoreError, match=r"checksum of array 'a' is wrong.*Remove that folder"):
        load_arrays(path)


@pytest.mark.parametrize("cut", [0, 5, -1])
def test_detects_damaged_chunk(tmp_path, cut):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.arange(1000.0)})
    chunk = chunk_of(path)
    chunk.write_bytes(chunk.read_bytes()[:cut])
    with pytest.raises(StoreError, match="damaged"):
        load_arrays(path)


def test_detects_lost_array(tmp_path):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.ones(3)})
    shutil.rmtree(path / "a")
    with pytest.raises(StoreError, match="array 'a' cannot be read"):
        load_arrays(path)


@pytest.mark.parametrize("text", ["", "{}", "not json", '{"zarr_format":3,"node_type":"group"}'])
def test_detects_damaged_description(tmp_path, text):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.ones(3)})
    (path / "zarr.json").write_text(text)
    with pytest.raises(StoreError, match="damaged"):
        load_meta(path)


def test_folder_without_description_does_not_block_its_name(tmp_path):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.ones(3)})
    (path / "zarr.json").unlink()
    save_arrays(path, {"a": np.zeros(3)})
    assert load_arrays(path)[0]["a"].tolist() == [0, 0, 0]


def test_newer_group_requires_upgrade(tmp_path):
    path = tmp_path / "x.zarr"
    save_arrays(path, {"a": np.ones(3)})
    description = json.loads((path / "zarr.json").read_text())
    description["attributes"]["schema_version"] = 2
    (path / "zarr.json").write_text(json.dumps(description))
    with pytest.raises(NewerSchemaError, match="Upgrade"):
        load_arrays(path)

"""Equal content has an equal digest everywhere; different content has a different one."""

import json
import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.storage.errors import InputError
from palpate.storage.json_digests import array_digest, digest, file_digest, source_digest
from tests.storage.stores_at_hand import run_python

CASE = {"E_fat": 0.1 + 0.2, "nodes": 2000, "labels": {10: "fat", 9: "é"}, "a": [1, None, True]}

PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def test_digest_has_sixteen_hexadecimal_digits():
    name = digest("x")
    assert len(name) == 16
    assert int(name, 16) >= 0


def test_digest_is_stable_across_versions():
    # sha256 of the bytes  ["evaluation",{"E":0.01,"n":[1,2]}]  by coreutils.
    assert digest("evaluation", {"n": (1, 2), "E": 0.01}) == "48251aa009290a63"


def test_digest_does_not_depend_on_the_hash_seed():
    code = """
import ast, sys
from palpate.storage.json_digests import digest
print(digest(ast.literal_eval(sys.argv[1])))
"""
    names = {run_python(code, repr(CASE)).stdout.strip() for _ in range(2)}
    assert names == {digest(CASE)}


@given(PLAIN, st.randoms())
@settings(max_examples=60, deadline=None)
def test_key_order_and_json_round_trip_do_not_matter(value: object, rng: random.Random):
    def shuffled(v: object) -> object:
        if isinstance(v, dict):
            items = list(v.items())
            rng.shuffle(items)
            return {k: shuffled(i) for k, i in items}
        return [shuffled(i) for i in v] if isinstance(v, list) else v

    assert digest(shuffled(value)) == digest(value)
    assert digest(json.loads(json.dumps(value))) == digest(value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1.0, 1.0000000000000002),
        (1, 1.0),
        (0.1 + 0.2, 0.3),
        (True, 1),
        (None, "null"),
        ("1", 1),
        ([1, [2]], [[1], 2]),
        ({"a": {"b": 1}}, {"a": 1, "b": {}}),
        (["ab", "c"], ["a", "bc"]),
    ],
)
def test_different_values_have_different_digests(one: object, other: object):
    assert digest(one) != digest(other)


def test_parts_are_kept_separate():
    assert digest("a", "b") != digest("ab")
    assert digest("a", "b") != digest(["a", "b"])


def test_integer_keys_equal_their_strings_in_any_order():
    assert digest({2: "a", 10: "b"}) == digest({"10": "b", "2": "a"})


def test_numpy_scalars_equal_numbers():
    assert digest(np.float64(0.1), np.int32(3), np.bool_(True)) == digest(0.1, 3, True)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, np.float32("nan")])
def test_refuses_nan_and_infinity(bad: float):
    with pytest.raises(InputError, match=r"digest\[0\]\.E_fat\[1\] is -?(nan|inf)"):
        digest({"E_fat": [1.0, bad]})


@pytest.mark.parametrize("bad", [{1, 2}, b"x", object(), {1.5: "a"}, {1: "a", "1": "b"}])
def test_refuses_values_that_are_not_json(bad: object):
    with pytest.raises(TypeError, match=r"digest\[0\]"):
        digest(bad)


def test_array_digest_ignores_memory_layout():
    array = np.arange(24, dtype=np.int32).reshape(2, 3, 4)
    name = array_digest(array)
    assert array_digest(np.asfortranarray(array)) == name
    assert array_digest(array.astype(">i4")) == name
    assert array_digest(np.repeat(array, 2, axis=2)[:, :, ::2]) == name
    others = [array.reshape(4, 3, 2), array.astype(np.int64), array + 1, array.view(np.uint32)]
    assert len({name, *map(array_digest, others)}) == 5


def test_file_digest_depends_on_bytes(tmp_path):
    (tmp_path / "a.nrrd").write_bytes(b"abc")
    (tmp_path / "b.nrrd").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1: sha256("abc") = ba7816bf 8f01cfea ...
    assert (
        file_digest(tmp_path / "a.nrrd") == file_digest(tmp_path / "b.nrrd") == "ba7816bf8f01cfea"
    )


def test_folder_digest_depends_on_names_and_bytes(tmp_path):
    series = tmp_path / "series"
    series.mkdir()
    (series / "1.dcm").write_bytes(b"one")
    (series / "2.dcm").write_bytes(b"two")
    name = file_digest(series)
    (series / ".DS_Store").write_bytes(b"noise")
    assert file_digest(series) == name
    (series / "2.dcm").rename(series / "3.dcm")
    assert file_digest(series) != name


def test_missing_file_raises_input_error(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        file_digest(tmp_path / "nothing.nrrd")


def test_source_digest_does_not_depend_on_the_location(tmp_path):
    def package(place: str, body: str) -> object:
        folder = tmp_path / place / "fem"
        (folder / "sub").mkdir(parents=True)
        (folder / "sub" / "kernels.py").write_text(body)
        (folder / "sub" / "notes.txt").write_text(place)
        return folder

    here, there, changed = package("a", "x = 1\n"), package("b", "x = 1\n"), package("c", "x = 2\n")
    assert source_digest([here]) == source_digest([there])
    assert source_digest([here]) != source_digest([changed])

"""The bounded cache of a process, and the settings of a Dask worker."""

import os
import threading
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from distributed import Client
from scipy import sparse

from palpate.workers import WORKER_ENVIRONMENT
from palpate.workers.resources import Cache, OneThread, size_bytes, worker_name

KILOBYTE = np.zeros(128)


def kilobyte():
    return np.zeros(128)


def test_value_is_computed_once():
    made = []
    cache = Cache()
    for _ in range(3):
        cache.get("a", lambda: made.append(1) or kilobyte())
    assert made == [1]


def test_least_recently_used_value_is_evicted_first():
    cache = Cache(capacity_bytes=2 * 1024)
    cache.get("a", kilobyte)
    cache.get("b", kilobyte)
    cache.get("a", kilobyte)
    cache.get("c", kilobyte)
    assert [key in cache for key in "abc"] == [True, False, True]
    assert cache.used_bytes == 2 * 1024


def test_value_larger_than_the_cache_is_kept_alone():
    cache = Cache(capacity_bytes=10)
    cache.get("a", kilobyte)
    cache.get("b", kilobyte)
    assert "b" in cache
    assert len(cache) == 1


def test_failed_value_is_computed_again():
    cache = Cache()

    def fail():
        raise OSError("no disk")

    for _ in range(2):
        try:
            cache.get("a", fail)
        except OSError:
            continue
    assert cache.get("a", lambda: 3) == 3


def test_concurrent_threads_share_one_value():
    cache, made, both = Cache(), [], threading.Barrier(4)

    def make():
        made.append(1)
        return kilobyte()

    def ask():
        both.wait()
        for key in range(20):
            cache.get(key, make)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 20


def test_clear_empties_the_cache():
    cache = Cache()
    cache.get("a", kilobyte)
    cache.clear()
    assert (len(cache), cache.used_bytes) == (0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    array: np.ndarray
    more: tuple


class Plain:
    def __init__(self, array):
        self.array = array


def test_bytes_of_nested_arrays_are_counted_once():
    matrix = sparse.csr_matrix(np.eye(4))
    parts = sum(a.nbytes for a in (matrix.data, matrix.indices, matrix.indptr))
    value = Part(KILOBYTE, ({"a": [KILOBYTE, kilobyte()]}, Plain(kilobyte()), matrix, "text", None))
    assert size_bytes(value) == 3 * 1024 + parts


@dataclass(frozen=True, eq=False)
class Later:
    """An object that makes an array on first access."""

    seen: object

    @cached_property
    def found(self):
        return kilobyte()


def test_bytes_of_functions_and_late_values_are_counted():
    array = kilobyte()
    value = Later(partial(lambda a, b: array, kilobyte(), b=kilobyte()))
    assert size_bytes(value) == 3 * 1024
    assert value.found.nbytes == 1024
    assert size_bytes(value) == 4 * 1024


def test_growing_values_evict_older_ones():
    cache = Cache(capacity_bytes=4 * 1024)
    for name in ("a", "b", "c"):
        cache.get(name, lambda: Later(None))
        assert cache.get(name, kilobyte).found.nbytes == 1024
    assert (len(cache), cache.used_bytes) == (3, 3 * 1024)
    cache.get("d", lambda: Later(kilobyte()))
    assert cache.get("d", kilobyte).found.nbytes == 1024
    cache.get("e", kilobyte)
    assert [name in cache for name in "abcde"] == [False, False, True, True, True]


def test_worker_name_outside_dask_is_host_and_process():
    assert worker_name().endswith(f"-{os.getpid()}")


def numba_threads():
    import numba

    return numba.get_num_threads(), dict(os.environ)


def test_dask_worker_has_one_thread_and_reports_its_name(monkeypatch):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with Client(n_workers=1, threads_per_worker=1, dashboard_address=":0") as client:
        client.register_plugin(OneThread())
        threads, environment = client.submit(numba_threads).result(timeout=60)
        name = client.submit(worker_name).result(timeout=60)
    assert threads == 1
    assert environment.items() >= WORKER_ENVIRONMENT.items()
    assert name == "0"


def test_unset_closure_variables_have_no_bytes():
    def known():
        return later

    assert size_bytes(known) == 0
    later = kilobyte()
    assert size_bytes(known) == 1024
    assert known() is later

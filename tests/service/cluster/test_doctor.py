"""The doctor: mixed processes, store and kernels."""

from typing import Any

from palpate.service.cluster.doctor_checks import _mixed, describe_process, try_kernels, try_store


def test_accepts_equal_processes() -> None:
    here = describe_process()
    assert set(here["packages"]) == {"service", "workers", "storage"}
    assert _mixed({"client": here, "scheduler": here, "worker tcp://x": here}) == []


def test_names_differing_code_and_libraries() -> None:
    here = describe_process()
    other: dict[str, Any] = here | {
        "source": "0" * 16,
        "packages": here["packages"] | {"workers": "/old/workers"},
        "versions": here["versions"] | {"numpy": "1.0"},
    }
    code, library = _mixed({"client": here, "worker tcp://x": other})
    assert "/old/workers" in code
    assert "install the same version everywhere" in code
    assert library.startswith("worker tcp://x has numpy 1.0")


def test_store_and_kernels_work_here(tmp_path: Any) -> None:
    assert try_store(str(tmp_path / "store"))["free_bytes"] > 0
    assert list((tmp_path / "store").glob(".palpate-probe*")) == []
    assert try_kernels()["threads"] >= 1

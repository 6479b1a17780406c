"""Versions of the code that results depend on: packages, Python and Palpate."""

import platform
from functools import cache
from importlib import metadata
from pathlib import Path

from palpate import workers
from palpate.service import search
from palpate.storage.digest import source_digest

PACKAGES = ("numpy", "scipy", "numba", "scikit-image", "zarr", "dask", "distributed", "cma")


@cache
def code_digest() -> str:
    """Return the digest of all source code that results depend on."""
    return source_digest([_folder(workers.__file__), _folder(search.__file__)])


def palpate_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return metadata.version("palpate")
    except metadata.PackageNotFoundError:
        return "not installed"


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    named = {
        "palpate": palpate_version(),
        "code": code_digest(),
        "python": platform.python_version(),
    }
    return tuple((named | {name: metadata.version(name) for name in PACKAGES}).items())


def versions() -> dict[str, str]:
    """Return the versions of Palpate, its code, Python and the packages that results depend on."""
    return dict(_versions())


def _folder(file: str | None) -> Path:
    assert file is not None  # packages on disk
    return Path(file).parent

"""Installed packages: optional ones, loaded on demand, and the versions that results depend on.

Results depend on packages, on Python and on the code of Palpate.
"""

import platform
from functools import cache
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from palpate import workers
from palpate.service import search
from palpate.storage.errors import InputError
from palpate.storage.json_digests import source_digest


def frame_type() -> Any:
    """Return `pandas.DataFrame`.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    return _loaded("pandas", "A table").DataFrame


def xarray() -> Any:
    """Return the module `xarray`.

    Raises
    ------
    InputError
        If xarray is not installed.
    """
    return _loaded("xarray", "A data set")


def pyarrow() -> Any:
    """Return the module `pyarrow` with `pyarrow.parquet`.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    _loaded("pyarrow.parquet", "A Parquet file")
    return import_module("pyarrow")


def _loaded(module: str, what: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise InputError(
            f"{what} needs {package}, which is not installed: run `pip install 'palpate[data]'`."
        ) from None


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

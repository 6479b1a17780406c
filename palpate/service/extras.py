"""Optional packages, loaded on demand."""

from importlib import import_module
from typing import Any

from palpate.storage.errors import InputError


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

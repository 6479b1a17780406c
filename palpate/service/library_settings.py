"""Settings of other libraries in a user's environment that keep them from being imported.

Dask, Numba, Matplotlib and Zarr read variables and files when they are imported. A value that they
cannot use ends any command, so its message should name the variable. The libraries are imported
only to find the reason for a failure, or by `palpate doctor`.
"""

import os
from collections.abc import Iterator
from importlib import import_module
from textwrap import shorten

# Module that reads the settings, and the beginnings of its variables.
LIBRARIES = {
    "dask": ("DASK_",),
    "distributed": ("DASK_",),
    "numba": ("NUMBA_",),
    "matplotlib": ("MPL", "MATPLOTLIB"),
    "zarr": ("ZARR_",),
}

# Characters of a library's message that are shown.
LONGEST = 200


def unusable_settings() -> Iterator[str]:
    """Yield a sentence for each library that cannot be imported because of its settings."""
    import_module("palpate.workers")  # sets variables, which must be done before NumPy loads
    refused: set[tuple[str, ...]] = set()
    for library, beginnings in LIBRARIES.items():
        try:
            import_module(library)
        except ImportError:
            continue  # not a matter of settings
        except Exception as error:
            if beginnings not in refused:
                refused.add(beginnings)
                yield _sentence(library, beginnings, error)


def _sentence(library: str, beginnings: tuple[str, ...], error: Exception) -> str:
    given = [f"{n}={v}" for n, v in sorted(os.environ.items()) if n.startswith(beginnings)]
    reason = shorten(str(error) or type(error).__name__, LONGEST, placeholder=" ...")
    where = f"in the environment ({', '.join(given)})" if given else "files"
    advice = "Correct or unset" if given else "Correct"
    what = "this variable" if len(given) == 1 else "them"
    return (
        f"{library} cannot be loaded with its settings {where}: {reason.rstrip(' .^:')}. "
        f"{advice} {what}, then repeat the command."
    )

"""Small tables shipped with the package; the first lines of each name its source."""

from functools import lru_cache
from importlib.resources import files

import numpy as np

from palpate.storage.values import FloatArray


@lru_cache(maxsize=32)
def table(name: str) -> FloatArray:
    """Read a table of two columns, shape (rows, 2), ascending in the first column.

    Parameters
    ----------
    name : str
        Name of a file in ``tables/``, without its suffix.
    """
    text = (
        files("palpate.workers.comparison.mammogram").joinpath("tables", f"{name}.csv").read_text()
    )
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    values = np.array(rows[1:], dtype=np.float64)  # the first row names the columns
    values.setflags(write=False)  # cached and shared
    return values

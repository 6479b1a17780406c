"""Stores and volumes for the tests of storage."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import Volume


def labels(shape: tuple[int, int, int] = (5, 6, 7), seed: int = 0) -> Volume:
    """Return random tissue labels with three different spacings, off the origin."""
    values = np.random.default_rng(seed).integers(0, 6, shape, dtype=np.uint8)
    return Volume(values, (0.3, 0.5, 0.7), (-12.25, 0.1, 1e-3))


def same_bits(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Return True if type, shape and bits are equal; NaN equals NaN, 0.0 does not equal -0.0."""
    return (one.dtype, one.shape) == (other.dtype, other.shape) and one.tobytes() == other.tobytes()


def run_python(code: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run code in a separate process."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

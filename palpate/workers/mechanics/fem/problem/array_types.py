"""Array types of the compiled kernels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
AnyFloatArray = NDArray[np.floating[Any]]
IndexArray = NDArray[np.uint32]
"""Unsigned: compiled loops need not check for negative indices."""

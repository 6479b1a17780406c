"""Nodal displacements, which are small and always kept.

The deformed volume can be computed again from mesh, reference volume and displacement.
"""

import numpy as np

from palpate.storage.errors import StoreError
from palpate.storage.stores.arrays import exists, load_arrays, save_arrays
from palpate.storage.stores.store import Store
from palpate.storage.values import FloatArray


def save_field(store: Store, digest: str, displacement_mm: FloatArray) -> None:
    """Write the displacement of the nodes of a mesh, whole or not at all.

    Parameters
    ----------
    store : Store
    digest : str
        Digest of the evaluation.
    displacement_mm : ndarray of float64, shape (n, 3)

    Raises
    ------
    StoreError
        If the shape or type is wrong, or the place cannot be written.
    """
    shape, dtype = displacement_mm.shape, displacement_mm.dtype
    if len(shape) != 2 or shape[1] not in (2, 3) or dtype != np.float64:
        raise StoreError(
            f"A displacement field has shape {shape} and type {dtype}, "
            "expected (n, 3), or (n, 2) for a section, and float64."
        )
    save_arrays(store.layout.field(digest), {"displacement_mm": displacement_mm})


def load_field(store: Store, digest: str) -> FloatArray:
    """Read a displacement, shape (n, 3) in mm.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    arrays, _ = load_arrays(store.layout.field(digest), ["displacement_mm"])
    return arrays["displacement_mm"]


def has_field(store: Store, digest: str) -> bool:
    """Return True if the field exists and is complete."""
    return exists(store.layout.field(digest))

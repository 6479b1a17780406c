"""Plain value types shared by all packages: a voxel volume and a mesh.

Nothing here reads or writes files.

Coordinates are ``(x, y, z)`` in mm; voxel arrays are indexed ``[z, y, x]``, so
x runs fastest in memory (the order of ITK). In a breast x is vertical, y is the
direction of compression and z runs from the chest wall to the nipple.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError

Triple = tuple[float, float, float]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]
BoolArray = NDArray[np.bool_]


class Tissue(IntEnum):
    """Labels of a voxel volume."""

    AIR = 0
    FAT = 1
    GLANDULAR = 2
    SKIN = 3
    MUSCLE = 4
    LIGAMENT = 5


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxels with a position in space.

    Parameters
    ----------
    values : ndarray, shape (nz, ny, nx)
        Labels (``uint8``, see `Tissue`), compartment ids (``uint16``) or grey values.
    spacing_mm : tuple of float
        Distance between voxel centres along x, y and z; > 0.
    origin_mm : tuple of float
        Centre of the voxel ``values[0, 0, 0]`` as (x, y, z).
    frame_uid : str
        DICOM frame of reference of these coordinates; empty if the file names none.
    place_known : bool
        True if the file gives the position of its voxels. False if origin or orientation had to be
        assumed: such a volume cannot be compared directly with another one.

    Raises
    ------
    InputError
        If the array is not 3-D or a spacing is not a positive number.
    """

    values: NDArray[Any]
    spacing_mm: Triple
    origin_mm: Triple = (0.0, 0.0, 0.0)
    frame_uid: str = ""
    place_known: bool = True

    def __post_init__(self) -> None:
        if self.values.ndim != 3:
            raise InputError(f"A volume needs 3 axes (z, y, x), got shape {self.values.shape}.")
        if not all(np.isfinite(s) and s > 0 for s in self.spacing_mm):
            raise InputError(
                f"Voxel spacing must be positive in x, y and z, got {self.spacing_mm} mm. "
                "Give it with --spacing-mm X Y Z."
            )

    @property
    def shape_xyz(self) -> tuple[int, int, int]:
        """Return the number of voxels along x, y and z."""
        nz, ny, nx = self.values.shape
        return nx, ny, nz

    @property
    def frame_facts(self) -> list[Any]:
        """Return the frame and `place_known` if either differs from its default, else nothing.

        It is the last part of a volume's digest; omitting defaults keeps older digests valid.
        """
        if self.place_known and not self.frame_uid:
            return []
        return [self.frame_uid, self.place_known]

    @property
    def voxel_mm3(self) -> float:
        """Return the volume of one voxel."""
        return float(np.prod(self.spacing_mm))

    def on_lattice_of(self, other: "Volume", tolerance: float = 1e-3) -> bool:
        """Return True if voxel centres of both volumes coincide (the boxes may differ)."""
        spacing = np.asarray(other.spacing_mm)
        shift = (np.asarray(self.origin_mm) - other.origin_mm) / spacing
        return bool(
            np.allclose(self.spacing_mm, spacing, rtol=1e-6)
            and np.all(np.abs(shift - np.rint(shift)) < tolerance)
        )


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Linear tetrahedra.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Coordinates (x, y, z) in mm.
    tets : ndarray of int32, shape (m, 4)
        Node numbers, positively oriented: ``det(x1-x0, x2-x0, x3-x0) > 0``.
    """

    nodes: FloatArray
    tets: IntArray

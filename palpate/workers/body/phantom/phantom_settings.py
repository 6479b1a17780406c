"""Settings of a breast phantom: size, voxels and tissue fractions."""

import math
from dataclasses import dataclass, fields, replace
from numbers import Integral, Real
from typing import Any, Final, Self

from palpate.storage.errors import InputError

MAX_VOXELS: Final = 600_000_000  # 1.8 GB of ids and labels together


@dataclass(frozen=True)
class Limit:
    """Bounds of a setting, with its unit for messages."""

    low: float
    high: float
    unit: str = ""


LIMITS: Final = {
    "lower_mm": Limit(15.0, 250.0, " mm"),
    "upper_mm": Limit(15.0, 250.0, " mm"),
    "half_width_mm": Limit(15.0, 150.0, " mm"),
    "depth_mm": Limit(15.0, 150.0, " mm"),
    "spacing_mm": Limit(0.2, 2.0, " mm"),
    "glandular_fraction": Limit(0.07, 0.35),
    "skin_mm": Limit(0.0, 4.0, " mm"),
    "ligament_mm": Limit(0.0, 3.0, " mm"),
    "compartments": Limit(20, 4000),
}


@dataclass(frozen=True)
class BreastPhantom:
    """Settings of a breast phantom made of quadratic compartments.

    The outline is two half ellipsoids on a flat chest wall (z = 0) that share
    the plane x = 0: semi-axes `lower_mm` below it, `upper_mm` above it,
    `half_width_mm` along y and `depth_mm` along z, with the nipple at
    ``(0, 0, depth_mm)``.

    Parameters
    ----------
    lower_mm, upper_mm : float
        Vertical extent: the body reaches from ``x = -lower_mm`` to ``upper_mm``.
    half_width_mm : float
        Half of the lateral extent (y, the direction of compression).
    depth_mm : float
        Chest wall to nipple (z).
    spacing_mm : float
        Edge of the cubic voxels, 0.2 to 2 mm.
    glandular_fraction : float
        Glandular share, by volume, of everything inside the skin; 0.07 to 0.35.
    skin_mm : float
        Thickness of the skin; 0 for none.
    ligament_mm : float
        Thickness of Cooper's ligaments, the sheets between compartments; 0 for none.
    compartments : int
        Number of compartment seeds; a few of them end up without any volume.

    Raises
    ------
    InputError
        If a setting is not a number or is outside its `LIMITS`, if skin fills
        the body or if the box would have more than `MAX_VOXELS`.

    Notes
    -----
    A voxel is skin or ligament if its *centre* is in the layer of nominal
    thickness, at every spacing. The fraction of each tissue then hardly depends on
    the voxel size. Voxels larger than a layer leave holes in it; thickening it
    to two voxels instead would turn a third of the body into ligament at 1 mm.

    References
    ----------
    .. [1] D. D. Pokrajac, A. D. A. Maidment, P. R. Bakic, "Optimized generation
       of high resolution breast anthropomorphic software phantoms", Med. Phys.
       39(4), 2290-2302, 2012: the outline of the default (445 ml).

    Examples
    --------
    >>> round(BreastPhantom.preset("250ml", spacing_mm=0.5).outline_ml, 1)
    250.3
    """

    lower_mm: float = 50.0
    upper_mm: float = 120.0
    half_width_mm: float = 50.0
    depth_mm: float = 50.0
    spacing_mm: float = 1.0
    glandular_fraction: float = 0.20
    skin_mm: float = 1.5
    ligament_mm: float = 0.6
    compartments: int = 333

    def __post_init__(self) -> None:
        for name, limit in LIMITS.items():
            _check(name, getattr(self, name), limit)
        if not isinstance(self.compartments, Integral):
            raise InputError(f"compartments must be a whole number, got {self.compartments!r}.")
        voxels = math.prod(self.shape_xyz)
        if voxels > MAX_VOXELS:
            raise InputError(
                f"A box of {self.width_mm:g} x {2 * self.half_width_mm:g} x {self.depth_mm:g} mm "
                f"at {self.spacing_mm:g} mm has {voxels:,} voxels, more than {MAX_VOXELS:,}. "
                "Use a larger spacing_mm."
            )

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Self:
        """Return the settings of a preset, with some of them changed.

        Parameters
        ----------
        name : {"445ml", "250ml"}
            See `PRESETS`.
        **changes
            Settings that replace those of the preset.

        Raises
        ------
        InputError
            If the preset or a setting is unknown, or a value is out of range.
        """
        if name not in PRESETS:
            raise InputError(f"Unknown phantom preset {name!r}; use one of {', '.join(PRESETS)}.")
        known = [field.name for field in fields(cls)]
        unknown = [key for key in changes if key not in known]
        if unknown:
            raise InputError(
                f"Unknown phantom setting {', '.join(unknown)}; use any of {', '.join(known)}."
            )
        return replace(cls(), **(PRESETS[name] | changes))

    @property
    def width_mm(self) -> float:
        """Return the vertical extent of the body."""
        return self.lower_mm + self.upper_mm

    @property
    def outline_ml(self) -> float:
        """Return the volume of the smooth outline, pi/3 a b (c' + c''), in ml."""
        return math.pi / 3 * self.half_width_mm * self.depth_mm * self.width_mm / 1000

    @property
    def voxels_below(self) -> int:
        """Number of voxels along x below the plane x = 0, which is a voxel face."""
        return _voxels(self.lower_mm, self.spacing_mm)

    @property
    def shape_xyz(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z of the smallest box around the body.

        The planes x = 0, y = 0 and z = 0 are voxel faces.
        """
        above = _voxels(self.upper_mm, self.spacing_mm)
        half = _voxels(self.half_width_mm, self.spacing_mm)
        return self.voxels_below + above, 2 * half, _voxels(self.depth_mm, self.spacing_mm)

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        """Return the centre of the first voxel as (x, y, z)."""
        h = self.spacing_mm
        return (0.5 - self.voxels_below) * h, (0.5 - self.shape_xyz[1] // 2) * h, 0.5 * h


PRESETS: Final[dict[str, dict[str, float]]] = {
    # 170 x 100 x 50 mm
    "445ml": {},
    # 170 x 75 x 37.5 mm
    "250ml": {"lower_mm": 37.5, "upper_mm": 132.5, "half_width_mm": 37.5, "depth_mm": 37.5},
}


def _check(name: str, value: object, limit: Limit) -> None:
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not limit.low <= value <= limit.high:  # type: ignore[operator]  # also NaN
        raise InputError(
            f"{name} must be between {limit.low:g} and {limit.high:g}{limit.unit}, got {value!r}."
        )


def _voxels(length_mm: float, spacing_mm: float) -> int:
    """Return the number of voxels that cover a length: exactly 250 of 0.2 mm for 50 mm."""
    return math.ceil(length_mm / spacing_mm - 1e-9)

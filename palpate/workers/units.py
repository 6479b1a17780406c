"""Units: mm, N, MPa and s inside; users' units in files and other interfaces.

A stiffness is given in kPa and computed in MPa. Numbers are converted by one
multiplication or division by an exact factor, so that 10 kPa is always 0.01 MPa to
the last bit.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of an interface.

    Parameters
    ----------
    symbol : str
        Printed symbol, such as "kPa"; empty for a pure number.
    inside : str
        Unit of the same quantity inside `workers`.
    per_inside : float
        Number of these units in one internal unit; exact in floating point.
    inside_per : float
        For a unit larger than the internal one: number of internal units in one of these. One of
        the two factors is 1, because a thousand is exact and a thousandth is not.

    Examples
    --------
    >>> KPA.to_inside(10.0)
    0.01
    >>> KPA.to_door(0.01)
    10.0
    >>> KPA.name_at_door("E_fat")
    'E_fat_kpa'
    >>> MM_PER_KPA.name_at_door("wall_compliance")
    'wall_compliance_mm_per_kpa'
    """

    symbol: str
    inside: str
    per_inside: float
    inside_per: float = 1.0

    def to_inside(self, value: float) -> float:
        """Convert from this unit to the internal unit."""
        return value * self.inside_per / self.per_inside

    def to_door(self, value: float) -> float:
        """Convert from the internal unit to this one."""
        return value * self.per_inside / self.inside_per

    def name_at_door(self, name: str) -> str:
        """Return `name` followed by its unit, as in files."""
        return f"{name}_{self.symbol.lower().replace('/', '_per_')}" if self.symbol else name

    def text(self, value_inside: float) -> str:
        """Format a value for display, such as "10 kPa"."""
        return f"{self.to_door(value_inside):g} {self.symbol}".rstrip()


KPA = Unit("kPa", "MPa", 1000.0)
PA = Unit("Pa", "MPa", 1e6)
MMHG = Unit("mmHg", "MPa", 1.0, 1.33322387e-4)
NUMBER = Unit("", "", 1.0)
N = Unit("N", "N", 1.0)
MM = Unit("mm", "mm", 1.0)
DEGREE = Unit("deg", "deg", 1.0)
G = Unit("g", "g", 1.0)  # multiples of the acceleration of gravity
KPA_PER_MM = Unit("kPa/mm", "MPa/mm", 1000.0)
MM_PER_KPA = Unit("mm/kPa", "mm/MPa", 1.0, 1000.0)
N_PER_M = Unit("N/m", "N/mm", 1000.0)

FORCE_UNITS = frozenset({KPA, PA, MMHG, G, N, KPA_PER_MM, MM_PER_KPA, N_PER_M})
"""Units of quantities that balance a force on a body: stiffness, pressure, weight."""

"""Units: mm, N, MPa and s inside; what users write at the door.

A stiffness is written in kPa and computed in MPa. Numbers are converted by one
multiplication or division by an exact factor, so that 10 kPa is 0.01 MPa to the
last bit wherever it was written.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit at the door.

    Parameters
    ----------
    symbol : str
        As printed, "kPa"; empty for a pure number.
    inside : str
        The unit of the same quantity inside `workers`.
    per_inside : float
        How many of this unit make one inside; exact in floating point.

    Examples
    --------
    >>> KPA.to_inside(10.0)
    0.01
    >>> KPA.to_door(0.01)
    10.0
    >>> KPA.name_at_door("E_fat")
    'E_fat_kpa'
    """

    symbol: str
    inside: str
    per_inside: float

    def to_inside(self, value: float) -> float:
        """From this unit to the one inside."""
        return value / self.per_inside

    def to_door(self, value: float) -> float:
        """From the unit inside to this one."""
        return value * self.per_inside

    def name_at_door(self, name: str) -> str:
        """`name` with its unit behind it, as users write it."""
        return f"{name}_{self.symbol.lower()}" if self.symbol else name

    def text(self, value_inside: float) -> str:
        """A value for a reader, "10 kPa"."""
        return f"{self.to_door(value_inside):g} {self.symbol}".rstrip()


KPA = Unit("kPa", "MPa", 1000.0)
NUMBER = Unit("", "", 1.0)

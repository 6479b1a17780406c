"""Plausible ranges of a cornea and its examination."""

from dataclasses import dataclass, replace

from palpate.workers.organs.cornea.material.load import MPA_PER_MMHG


@dataclass(frozen=True)
class Range:
    """An interval with its unit, including both ends.

    Parameters
    ----------
    least, most : float
    unit : str
    what : str
        The quantity, as the subject of a sentence.
    """

    least: float
    most: float
    unit: str
    what: str

    def __contains__(self, value: float) -> bool:
        return self.least <= value <= self.most

    def __str__(self) -> str:
        return f"{self.least:g} to {self.most:g} {self.unit}"

    def in_mmhg(self) -> "Range":
        """Return a range of pressures in kPa converted to mmHg."""
        by = 1e-3 / MPA_PER_MMHG
        least, most = round(self.least * by), round(self.most * by)
        return replace(self, least=least, most=most, unit="mmHg")


RADIUS_MM = Range(6.0, 10.0, "mm", "the radius of a cornea")
CENTRAL_MM = Range(0.4, 0.75, "mm", "the central thickness of a cornea")
# Of a cornea from limbus to limbus, and of a frame that shows enough of it.
WIDTH_MM = Range(6.0, 14.0, "mm", "the width of a section")
# Under a jet the thickness along the normal varies with the error of the posterior surface.
PRESSED_CENTRAL_MM = Range(0.35, 0.9, "mm", "the central thickness under a jet")
IOP_MMHG = Range(4.0, 70.0, "mmHg", "the pressure of an eye")
JET_KPA = Range(0.5, 60.0, "kPa", "the pressure of an air jet on the eye")

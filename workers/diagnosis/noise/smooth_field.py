"""What is believed of a smooth field that stands for something else than what is listed.

An unknown displacement seen along the normals; see `diagnosis.noise.nuisances.smooth_covariance`
(the model discrepancy of M. C. Kennedy and A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425).
"""

from dataclasses import dataclass

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.settings.state_correlation import StateCorrelation
from palpate.workers.diagnosis.settings.values import SETTINGS


@dataclass(frozen=True, slots=True)
class SmoothField:
    """What is believed of the field before data.

    Parameters
    ----------
    amplitudes_mm, lengths_mm : tuple of float
        Standard deviations of the displacement along any direction, and correlation
        lengths; all pairs are equally probable.
    state_correlation : StateCorrelation

    Raises
    ------
    InputError
        If a number is out of range.
    """

    amplitudes_mm: tuple[float, ...] = SETTINGS.smooth_field.amplitudes_mm
    lengths_mm: tuple[float, ...] = SETTINGS.smooth_field.lengths_mm
    state_correlation: StateCorrelation = SETTINGS.smooth_field.state_correlation

    def __post_init__(self) -> None:
        scales = self.amplitudes_mm + self.lengths_mm
        usable = self.amplitudes_mm and self.lengths_mm and min(scales) > 0
        if not usable:
            raise InputError(f"A smooth field needs amplitudes > 0 and lengths > 0, found {self}.")

    @property
    def middle_amplitude_mm(self) -> float:
        """The middle one of the amplitudes."""
        return sorted(self.amplitudes_mm)[len(self.amplitudes_mm) // 2]

    @property
    def middle_length_mm(self) -> float:
        """The middle one of the lengths."""
        return sorted(self.lengths_mm)[len(self.lengths_mm) // 2]

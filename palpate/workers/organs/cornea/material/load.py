"""Loads on a cornea: intraocular pressure, an air jet, and motion of the eye."""

import math
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

MPA_PER_MMHG = 1.33322387e-4


@dataclass(frozen=True, slots=True)
class JetProfile:
    """Pressure of an air jet over the distance from its centre.

    Linear between the points, constant before the first, zero beyond the last.

    Parameters
    ----------
    r_mm : tuple of float
        Ascending and not negative, the last positive.
    fraction : tuple of float
        Fractions of the jet's pressure, not negative.

    Raises
    ------
    InputError
        If the table is empty, of uneven length, not ascending, or has a negative number.
    """

    r_mm: tuple[float, ...]
    fraction: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.r_mm or len(self.r_mm) != len(self.fraction):
            raise InputError(
                "The profile of an air jet needs one fraction of the pressure for every "
                f"distance, got {len(self.r_mm)} distances and {len(self.fraction)} fractions."
            )
        numbers = (*self.r_mm, *self.fraction)
        rising = all(a < b for a, b in zip(self.r_mm, self.r_mm[1:], strict=False))
        if not all(map(math.isfinite, numbers)) or min(numbers) < 0 or not rising:
            raise InputError(
                "The profile of an air jet needs ascending distances and fractions that are "
                f"not negative, got r_mm {self.r_mm} and fraction {self.fraction}."
            )
        if self.r_mm[-1] == 0:
            raise InputError("The profile of an air jet ends at the distance 0. Give its radius.")

    def at(self, distance_mm: FloatArray) -> FloatArray:
        """Return the fraction of the pressure at distances from the centre."""
        inside = np.interp(distance_mm, self.r_mm, self.fraction)
        return np.where(distance_mm <= self.r_mm[-1], inside, 0.0)


@dataclass(frozen=True, slots=True)
class CorneaLoad:
    """Pressures on the two surfaces, and the motion of the whole eye under the jet.

    The jet acts on the part of the anterior surface that is under it in the image of the
    undeformed cornea, and follows the normal.

    Parameters
    ----------
    iop_mpa : float
        Intraocular pressure, present in the image of the undeformed cornea.
    jet_pressure_mpa : float
        15 kPa by default. The thesis prints 15 mmHg, at which no cornea becomes concave;
        15 kPa = 112.5 mmHg gives the 1 mm seen in its images.
    jet_centre_mm : float
        Position x of the axis of the jet.
    jet_diameter_mm : float
        Diameter of a uniform jet.
    jet_profile : JetProfile, optional
        Replaces the uniform jet and its diameter.
    jet_width_factor : float
        Factor of the jet's width, whether uniform or not.
    iop_rise_mpa : float
        Increase of the intraocular pressure by the jet.
    eye_shift_mm : tuple of float
        Motion (x, y) of the limbus under the jet.
    eye_tilt_rad : float
        Rotation of the limbus about its centre under the jet, counter-clockwise.

    Raises
    ------
    InputError
        If a pressure is negative, a width not positive, or a number is not finite.
    """

    iop_mpa: float
    jet_pressure_mpa: float = 0.015
    jet_centre_mm: float = 0.0
    jet_diameter_mm: float = 3.0
    jet_profile: JetProfile | None = None
    jet_width_factor: float = 1.0
    iop_rise_mpa: float = 0.0
    eye_shift_mm: tuple[float, float] = (0.0, 0.0)
    eye_tilt_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = (
            self.iop_mpa,
            self.jet_pressure_mpa,
            self.jet_centre_mm,
            self.jet_diameter_mm,
            self.jet_width_factor,
            self.iop_rise_mpa,
            *self.eye_shift_mm,
            self.eye_tilt_rad,
        )
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"The load on a cornea must consist of finite numbers, got {self}.")
        if self.iop_mpa < 0 or self.jet_pressure_mpa < 0:
            raise InputError(
                "The pressure in the eye and of the air jet cannot be negative, got "
                f"{self.iop_mpa / MPA_PER_MMHG:.4g} and "
                f"{self.jet_pressure_mpa / MPA_PER_MMHG:.4g} mmHg."
            )
        if self.jet_diameter_mm <= 0 or self.jet_width_factor <= 0:
            raise InputError(
                "An air jet needs a positive diameter and width factor, got "
                f"{self.jet_diameter_mm:g} mm and {self.jet_width_factor:g}."
            )

    @property
    def profile(self) -> JetProfile:
        """Return the profile of the jet, widened; a uniform one has a single point."""
        profile = self.jet_profile or JetProfile((self.jet_diameter_mm / 2,), (1.0,))
        widened = tuple(r * self.jet_width_factor for r in profile.r_mm)
        return JetProfile(widened, profile.fraction)

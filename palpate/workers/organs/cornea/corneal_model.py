"""The model of a cornea: constants of its law, loads, options and plausible ranges.

The law is an Ogden law of any order with one bulk modulus. Loads are the intraocular pressure, an
air jet and the motion of the whole eye. `CorneaModel` holds the options other than mesh,
constants and load; among them is the number of quadrature points on a triangle. Nothing here needs
the solver, so the keys of a study file are read quickly.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

# Degree 2 and degree 5; O. C. Zienkiewicz and R. L. Taylor, The Finite Element Method.
_POINT_A, _POINT_B = 0.470142064105115, 0.101286507323456
_POINT_WEIGHTS = (0.1125, 0.066197076394253, 0.0629695902724135)
QUADRATURE: dict[int, tuple[FloatArray, FloatArray]] = {
    3: (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 6)),
    7: (
        np.array(
            [
                [1 / 3, 1 / 3],
                [_POINT_A, _POINT_A],
                [1 - 2 * _POINT_A, _POINT_A],
                [_POINT_A, 1 - 2 * _POINT_A],
                [_POINT_B, _POINT_B],
                [1 - 2 * _POINT_B, _POINT_B],
                [_POINT_B, 1 - 2 * _POINT_B],
            ]
        ),
        np.array([_POINT_WEIGHTS[0], *[_POINT_WEIGHTS[1]] * 3, *[_POINT_WEIGHTS[2]] * 3]),
    ),
}


Kind = Literal["plane stress", "plane strain", "axisymmetric"]
PrestressMethod = Literal["additive", "mulf", "inverse", "none"]


@dataclass(frozen=True, slots=True)
class CorneaModel:
    """Options of a simulation.

    Parameters
    ----------
    kind : {"plane stress", "plane strain", "axisymmetric"}
        In an axisymmetric section each half is revolved by half a turn about x = 0, so the mesh
        needs an edge there.
    prestress : {"additive", "mulf", "inverse", "none"}
        How the imaged cornea is brought into equilibrium with the intraocular pressure; see
        `prestress`. With "none" the imaged cornea is stress-free.
    limbus_mpa_per_mm : float or None
        Stiffness of an elastic support of the limbus, per area; None clamps it.
    depth_gradient, side_gradient : float
        Change of ln(modulus) from the anterior to the posterior surface, and from left to
        right; the mean over the section is kept at zero.
    quadrature_points : {3, 7}
        Number per triangle.
    tolerance_mm : float
        Error of the displacement at which Newton's method stops.
    prestress_tolerance_mm : float
        Displacement from the image at which the iteration for the prestress stops.

    Raises
    ------
    InputError
        If an option is unknown, or a stiffness or tolerance is not positive.
    """

    kind: Kind = "plane stress"
    prestress: PrestressMethod = "additive"
    limbus_mpa_per_mm: float | None = None
    depth_gradient: float = 0.0
    side_gradient: float = 0.0
    quadrature_points: int = 3
    tolerance_mm: float = 1e-7
    prestress_tolerance_mm: float = 1e-5

    def __post_init__(self) -> None:
        options = (
            ("kind of section", self.kind, get_args(Kind)),
            ("prestress", self.prestress, get_args(PrestressMethod)),
            ("number of quadrature points", self.quadrature_points, tuple(QUADRATURE)),
        )
        for name, value, allowed in options:
            if value not in allowed:
                raise InputError(
                    f"The {name} of a corneal model must be one of {', '.join(map(str, allowed))}; "
                    f"got {value!r}."
                )
        if self.limbus_mpa_per_mm is not None and not self.limbus_mpa_per_mm > 0:
            raise InputError(
                "An elastic limbus needs a positive stiffness, got "
                f"{1e3 * self.limbus_mpa_per_mm:g} kPa/mm. Omit it to clamp the limbus."
            )
        if not (self.tolerance_mm > 0 and self.prestress_tolerance_mm > 0):
            raise InputError(
                "Tolerances of a corneal model must be positive, got "
                f"{self.tolerance_mm:g} and {self.prestress_tolerance_mm:g} mm."
            )


Convention = Literal["mu/alpha", "2mu/alpha^2", "mu/alpha^2"]

DEFAULT_BULK_MPA = 10.0  # K_i = 1e7 Pa, thesis section 5.3


class OgdenLaw(NamedTuple):
    """Constants in the form used by compiled loops.

    Parameters
    ----------
    modulus_mpa, exponent : ndarray, shape (N,)
        Factor and power of each term of ``tau_a = sum_i m_i (q_a - mean q)``.
    bulk_mpa : float
    plane_stress_ratio : float
        ``- ln(lambda_3) / (ln(lambda_1) + ln(lambda_2))`` for a small strain in plane stress,
        the initial guess of the thickness.
    """

    modulus_mpa: FloatArray
    exponent: FloatArray
    bulk_mpa: float
    plane_stress_ratio: float


@dataclass(frozen=True, slots=True)
class CorneaConstants:
    r"""Ogden constants with the volumetric term of the thesis.

    .. math:: W = \sum_{i=1}^{N} \left[ c_i \left( \bar\lambda_1^{\alpha_i}
              + \bar\lambda_2^{\alpha_i} + \bar\lambda_3^{\alpha_i} - 3 \right)
              + \frac{K}{2} (J - 1)^{2 i} \right]

    =============  ====================  ==================  =====================
    convention     factor c_i            used by             shear modulus at rest
    =============  ====================  ==================  =====================
    mu/alpha       mu_i / alpha_i        thesis, Ansys       sum of mu alpha / 2
    2mu/alpha^2    2 mu_i / alpha_i^2    Abaqus              sum of mu
    mu/alpha^2     mu_i / alpha_i^2      FEBio               sum of mu / 2
    =============  ====================  ==================  =====================

    Parameters
    ----------
    mu_mpa, alpha : tuple of float
        One value of each per term.
    bulk_mpa : float
        K, the same for all N powers of J - 1.
    convention : {"mu/alpha", "2mu/alpha^2", "mu/alpha^2"}

    Raises
    ------
    InputError
        If the lengths differ, an exponent is zero, a number is not finite, or the shear
        or the bulk modulus is not positive.

    References
    ----------
    M. A. Lago, PhD thesis, Universitat Politecnica de Valencia, 2014, Eq. 5.1.

    Examples
    --------
    >>> round(CorneaConstants(mu_mpa=(0.011, 0.035), alpha=(30, 80)).shear_modulus_mpa, 3)
    1.565
    """

    mu_mpa: tuple[float, ...]
    alpha: tuple[float, ...]
    bulk_mpa: float = DEFAULT_BULK_MPA
    convention: Convention = "mu/alpha"

    def __post_init__(self) -> None:
        if not self.mu_mpa or len(self.mu_mpa) != len(self.alpha):
            raise InputError(
                "The law of a cornea needs one exponent alpha for every modulus mu, got "
                f"{len(self.mu_mpa)} moduli and {len(self.alpha)} exponents."
            )
        if self.convention not in get_args(Convention):
            raise InputError(
                f"Ogden conventions are {', '.join(get_args(Convention))}; got {self.convention!r}."
            )
        if not all(map(math.isfinite, (*self.mu_mpa, *self.alpha, self.bulk_mpa))):
            raise InputError(f"The constants of a cornea must be finite numbers, got {self}.")
        if 0 in self.alpha:
            raise InputError(f"The exponents of an Ogden law must not be 0, got {self.alpha}.")
        if self.shear_modulus_mpa <= 0 or self.bulk_mpa <= 0:
            raise InputError(
                "A cornea needs a positive shear and bulk modulus, got "
                f"{self.shear_modulus_mpa:g} and {self.bulk_mpa:g} MPa. "
                "The shear modulus is the sum of mu alpha / 2 in the convention mu/alpha."
            )

    @property
    def moduli_mpa(self) -> tuple[float, ...]:
        """Return ``c_i alpha_i``, the moduli in the convention mu/alpha."""
        factor = {"mu/alpha": None, "2mu/alpha^2": 2.0, "mu/alpha^2": 1.0}[self.convention]
        if factor is None:
            return self.mu_mpa
        return tuple(factor * m / a for m, a in zip(self.mu_mpa, self.alpha, strict=True))

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest, half of sum ``c_i alpha_i^2``."""
        return sum(m * a for m, a in zip(self.moduli_mpa, self.alpha, strict=True)) / 2

    def law(self) -> OgdenLaw:
        """Return the constants in the form used by compiled loops."""
        lame = self.bulk_mpa - 2 / 3 * self.shear_modulus_mpa
        return OgdenLaw(
            np.array(self.moduli_mpa, dtype=float),
            np.array(self.alpha, dtype=float),
            float(self.bulk_mpa),
            lame / (lame + 2 * self.shear_modulus_mpa),
        )


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
